"""The linear regions of a decoder along lines: their value, slope, length, and their use."""

import torch
from torch import Tensor

from shift3d.sdf.decoder import Architecture, Decoder
from shift3d.sdf.field import Field


def small_field(seed: int = 0) -> Field:
    torch.manual_seed(seed)
    decoder = Decoder(Architecture(code_length=4, width=24, hidden_layers=5, skip_layer=3)).folded().double()
    for layer in decoder.layers:
        torch.nn.init.normal_(layer.weight, std=0.35)
        torch.nn.init.normal_(layer.bias, std=0.2)
    return decoder.requires_grad_(False).field(torch.randn(4, dtype=torch.float64))


def lines(count: int = 200) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    x = 2 * torch.rand(count, 3, generator=generator, dtype=torch.float64) - 1
    d = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)
    return x, d


def test_value_and_slope_are_those_of_the_field() -> None:
    field, (x, d) = small_field(), lines()
    region = field.region(x, d)
    leaf = x.clone().requires_grad_()
    before_tanh = torch.atanh(field(leaf))
    (gradient,) = torch.autograd.grad(before_tanh.sum(), leaf)
    assert torch.allclose(region.value, before_tanh.detach(), rtol=1e-9, atol=1e-12)
    assert torch.allclose(region.slope, (gradient * d).sum(1), rtol=1e-9, atol=1e-12)


def test_a_region_is_linear_to_its_end_and_no_further() -> None:
    field, (x, d) = small_field(), lines()
    region = field.region(x, d)
    ends = torch.isfinite(region.length)
    assert ends.sum() > 100
    for share in (0.3, 0.9, 1.0):
        k = torch.where(ends, region.length, 0.0) * share
        assert torch.allclose(
            torch.atanh(field(x + k[:, None] * d)), region.value + k * region.slope, rtol=1e-8, atol=1e-10
        )
    beyond = field.region(x + (region.length + 1e-9)[:, None] * d, d)
    changed = (beyond.slope - region.slope).abs() > 1e-9
    # A unit without influence on the output changes nothing when it switches.
    assert changed[ends].double().mean() > 0.7


def test_traversal_finds_every_root_that_dense_sampling_finds_first() -> None:
    field, (x, d) = small_field(), lines()
    k = torch.linspace(0, 2, 20001, dtype=torch.float64)
    for start, direction in zip(x[:60], d[:60]):
        g = field(start + k[:, None] * direction)
        change = torch.nonzero((g[1:] < 0) != (g[0] < 0)).squeeze(1)
        at = 0.0
        while at < 2.0:
            region = field.region((start + at * direction)[None], direction[None])
            root = float(-region.value / region.slope)
            if 0 <= root <= float(region.length):
                at += root
                break
            at += float(region.length) + 1e-12
        if len(change):
            assert at <= float(k[change[0] + 1]) + 1e-9
            # Nearer only if it is a crossing between two samples.
            if at < float(k[change[0]]) - 1e-9:
                around = field(start + torch.tensor([[at - 1e-7], [at + 1e-7]], dtype=torch.float64) * direction)
                assert around[0] * around[1] <= 0
        else:
            assert at >= 2.0 or abs(float(field((start + at * direction)[None]))) < 1e-9


def test_a_unit_at_its_switch_belongs_to_the_region_ahead() -> None:
    weight = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    field = Field([weight, torch.ones(1, 1, dtype=torch.float64)], [torch.zeros(1).double()] * 2, skip_layer=-1)
    at_zero = torch.zeros(2, 3, dtype=torch.float64)
    ahead = field.region(at_zero, torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]], dtype=torch.float64))
    assert ahead.slope.tolist() == [1.0, 0.0]
    assert torch.isinf(ahead.length).all()
    toward = field.region(at_zero + 0.5, torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]], dtype=torch.float64))
    assert toward.length.tolist() == [float("inf"), 0.5]
