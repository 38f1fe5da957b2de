"""A decoder's derivatives at many points at once, against autograd one by one."""

import pytest
import torch

from shift3d.sdf.decoder import Architecture, Decoder, load_decoder
from shift3d.sdf.field import Field


def with_code(double: bool = True) -> tuple[Field, torch.Tensor]:
    torch.manual_seed(0)
    decoder = Decoder(Architecture(code_length=4, width=24, hidden_layers=5, skip_layer=3)).folded()
    decoder = decoder.double() if double else decoder
    code = torch.randn(4, dtype=torch.float64 if double else torch.float32).requires_grad_()
    return decoder.requires_grad_(False).field(code), code


def places(count: int = 60) -> torch.Tensor:
    return 2 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 1


def test_every_derivative_is_autograds() -> None:
    field, _code = with_code()
    assert field.code_layers == (0, 3)
    x = places().requires_grad_()
    value = field(x)
    tangent = field.tangent(x, field.code_layers)
    (at_point,) = torch.autograd.grad(value.sum(), x, retain_graph=True)
    assert torch.allclose(tangent.value, value.detach(), rtol=0, atol=1e-15)
    assert torch.allclose(tangent.at_point, at_point, rtol=0, atol=1e-14)
    for row in range(len(x)):
        biases = [field.biases[layer] for layer in field.code_layers]
        one_by_one = torch.autograd.grad(value[row], biases, retain_graph=True)
        for found, expected in zip(tangent.at_bias, one_by_one, strict=True):
            assert torch.allclose(found[row], expected, rtol=0, atol=1e-14)


def test_a_field_without_a_code_to_follow_has_none() -> None:
    field, _ = with_code()
    assert field.detach().code_layers == ()
    assert field.tangent(places()).at_bias == ()


def test_the_bias_of_the_last_layer_is_one_too() -> None:
    field, _ = with_code()
    found = field.tangent(places(), (5,))
    assert torch.allclose(found.at_bias[0][:, 0], 1 - found.value**2)


@pytest.mark.parametrize("count", [1, 500])
def test_full_size_in_float32_is_float64s_to_a_rounding(count: int) -> None:
    decoder = load_decoder()
    code = torch.zeros(decoder.architecture.code_length).requires_grad_()
    single, double = decoder.field(code), load_decoder().double().field(code.detach().double().requires_grad_())
    x = 0.6 * places(count)
    fine, rough = double.tangent(x, double.code_layers), single.tangent(x, single.code_layers)
    assert float((fine.value - rough.value).abs().max()) < 1e-5
    # A unit at its switch may be on in one and off in the other: most derivatives agree, none is far off.
    off = (fine.at_point - rough.at_point).norm(dim=1) / fine.at_point.norm(dim=1)
    assert float(off.median()) < 1e-4 and float(off.max()) < 0.2
