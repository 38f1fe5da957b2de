"""A decoder without its inactive hidden units: the same field wherever its survey was."""

import pytest
import torch
from analytic_fields import Frame
from random_networks import random_decoder
from torch import Tensor

from shift3d.processor import has_fast_bfloat16
from shift3d.render.field.object_field import ObjectField
from shift3d.sdf.bfloat16 import Bfloat16Field
from shift3d.sdf.field import Field

SEEDS = pytest.mark.parametrize("seed", range(6))


def code(seed: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return 0.3 * torch.randn(5, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def field(seed: int, dtype: torch.dtype = torch.float64) -> Field:
    return random_decoder(seed).to(dtype).field(code(seed, dtype))


def places(count: int = 400, reach: float = 1.0, seed: int = 0) -> Tensor:
    return reach * (
        2.0 * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1.0
    )


def units_on(whole: Field, x: Tensor) -> list[Tensor]:
    """Return a bool mask per hidden layer, by the plain formula."""
    hidden, found = x, []
    for layer, (weight, bias) in enumerate(zip(whole.weights[:-1], whole.biases[:-1], strict=True)):
        hidden = (torch.cat((hidden, x), 1) if layer == whole.skip_layer else hidden) @ weight.T + bias
        hidden = torch.where(hidden > 0, hidden, 0.0)
        found.append((hidden > 0).any(0))
    return found


@SEEDS
def test_a_survey_reports_exactly_the_units_that_are_on(seed: int) -> None:
    whole, x = field(seed), places()
    g, live = whole.survey(x)
    assert torch.allclose(g, whole(x), rtol=0, atol=1e-14)
    assert all(torch.equal(a, b) for a, b in zip(live, units_on(whole, x), strict=True))
    assert 0.1 < float(torch.cat(live).double().mean()) < 0.9, "some are on, some are off"


@SEEDS
@pytest.mark.parametrize(("dtype", "rounding"), [(torch.float32, 1e-6), (torch.float64, 1e-14)])
def test_the_same_values_where_only_live_units_are_on(seed: int, dtype: torch.dtype, rounding: float) -> None:
    whole, x = field(seed, dtype), places().to(dtype)
    _, live = whole.survey(x)
    thin = whole.sliced(live)
    assert sum(w.numel() for w in thin.weights) < 0.9 * sum(w.numel() for w in whole.weights)
    assert float((thin(x) - whole(x)).abs().max()) <= rounding
    # And elsewhere, wherever no other unit is active.
    for one in places(200, 1.3, seed=9).to(dtype).split(1):
        if not any(bool((on & ~known).any()) for on, known in zip(units_on(whole, one), live, strict=True)):
            assert float((thin(one) - whole(one)).abs().max()) <= rounding


@SEEDS
def test_the_same_derivatives_by_the_point_and_by_the_code(seed: int) -> None:
    x = places(100)
    z = code(seed).requires_grad_()
    whole = random_decoder(seed).double().field(z)
    thin = whole.sliced(whole.survey(x)[1])
    assert thin.code_layers == whole.code_layers == (0, 2)
    a, b = (each.tangent(x, each.code_layers) for each in (whole, thin))
    assert torch.allclose(a.at_point, b.at_point, rtol=0, atol=1e-13)
    for one, other in zip(a.at_bias, b.at_bias, strict=True):
        assert one.shape == other.shape and torch.allclose(one, other, rtol=0, atol=1e-13)
    by_code = [torch.autograd.grad(each(x).sin().sum(), z, retain_graph=True)[0] for each in (whole, thin)]
    assert float(by_code[0].norm()) > 0 and torch.allclose(*by_code, rtol=1e-11, atol=1e-13)


@SEEDS
def test_a_survey_that_misses_units_shows(seed: int) -> None:
    whole, x = field(seed), places(reach=1.3)
    _, live = whole.survey(places(4, 0.02))
    assert float((whole.sliced(live)(x) - whole(x)).abs().max()) > 1e-4


@pytest.mark.parametrize("layer", range(5))
def test_a_nan_is_on_and_shows(layer: int) -> None:
    whole, x = field(0), places(50)
    unit = int(torch.nonzero(~units_on(whole, x)[layer])[0])
    whole.biases[layer] = whole.biases[layer].clone()
    whole.biases[layer][unit] = torch.nan
    g, live = whole.survey(x)
    assert torch.isnan(g).all() and bool(live[layer][unit])
    assert torch.isnan(whole.sliced(live)(x)).all()


def test_a_field_that_is_on_everywhere_stays_whole() -> None:
    whole = field(1)
    thin = whole.sliced([torch.ones(len(bias), dtype=torch.bool) for bias in whole.biases[:-1]])
    assert all(torch.equal(a, b) for a, b in zip(whole.weights, thin.weights, strict=True))


def test_the_same_units_are_the_same_slice_and_others_another() -> None:
    whole, x = field(1), places()
    live = whole.survey(x[:50])[1]
    thin = whole.sliced(live)
    assert whole.sliced([mask.clone() for mask in live]) is thin
    other = [mask.clone() for mask in live]
    off = torch.nonzero(~other[1]).squeeze(1)
    other[1][off] = True
    assert len(off) and whole.sliced(other).weights[1].shape[0] > thin.weights[1].shape[0]
    again = whole.sliced(live)
    assert all(torch.equal(a, b) for a, b in zip(again.weights, thin.weights, strict=True))


def test_an_object_field_surveys_in_batches_and_counts_on() -> None:
    whole, x = field(2), places(100)
    metric = ObjectField.of(whole, Frame(scale_m=2.5), torch.float64, 32)
    g, live = metric.survey(2.5 * x)
    assert live is not None and torch.allclose(g, 2.5 * whole(x), atol=1e-13) and metric.count.evaluations == 100
    assert all(torch.equal(a, b) for a, b in zip(live, units_on(whole, x), strict=True))
    thin = metric.sliced(live)
    assert torch.allclose(thin(2.5 * x), metric(2.5 * x), atol=1e-13) and metric.count.evaluations == 300
    assert metric.sliced(None) is metric
    shape = ObjectField.of(lambda at: at[:, 0], Frame(), torch.float64, 32)
    assert shape.survey(x)[1] is None and shape.sliced(live) is shape


@pytest.mark.skipif(not has_fast_bfloat16(), reason="this processor has no fast bfloat16")
def test_a_survey_in_bfloat16_reports_what_is_on_but_for_what_hardly_is() -> None:
    whole, x = field(3, torch.float32), places().float()
    rough, live = Bfloat16Field(whole.weights, whole.biases, whole.skip_layer).survey(x)
    exact, on = whole.survey(x)
    assert float((rough - exact).abs().max()) < 0.02
    differs = torch.cat(live) != torch.cat(on)
    assert float(differs.double().mean()) < 0.05
