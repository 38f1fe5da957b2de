"""bfloat16 far from the surface: accurate enough for a step, never used for a sign."""

import numpy as np
import pytest
import torch
from analytic_fields import Frame, sector_scan

from shift3d.geometry.se3 import object_from_scene
from shift3d.placement.constraints import snap_to_ground
from shift3d.render import Beams, preset, render
from shift3d.render.field.object_field import ObjectField
from shift3d.sdf.decoder import DEFAULT_WEIGHTS, Decoder, load_decoder
from shift3d.sdf.field import Field


@pytest.fixture(scope="module")
def shipped() -> tuple[Field, Frame]:
    from shift3d.vehicles.vehicle import DEFAULT_VEHICLES, baseline_vehicles

    if not (DEFAULT_WEIGHTS.is_file() and DEFAULT_VEHICLES.is_file()):
        pytest.skip("no shipped weights yet")
    v = baseline_vehicles()["coupe"]
    frame = Frame(v.size_m, v.scale_m, v.sdf_R_object, v.sdf_t_object)
    return load_decoder().field(torch.from_numpy(v.latent_code)), frame


needs_bfloat16 = pytest.mark.skipif(
    not torch.ops.mkldnn._is_mkldnn_bf16_supported(), reason="this processor has no fast bfloat16"
)


@needs_bfloat16
def test_the_estimate_is_exact_near_the_surface_and_close_elsewhere(shipped: tuple[Field, Frame]) -> None:
    field, frame = shipped
    metric = ObjectField.of(field, frame, torch.float32, 4096, bfloat16_band_m=0.02)
    x = (torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)).double() - 0.5) * torch.tensor([5.0, 2.4, 2.0])
    exact, estimate = metric(x), metric.estimate(x)
    assert torch.equal(estimate[estimate < 0.02], exact[estimate < 0.02])
    assert torch.equal(estimate < 0, exact < 0)
    assert float((estimate - exact).abs().max()) < 0.015
    assert 500 < metric.count.coarse < 4000


@needs_bfloat16
@pytest.mark.parametrize("expectation", ["right", "wrong", "unknown", "all near"])
def test_whatever_is_expected_near_the_surface_it_is_exact(shipped: tuple[Field, Frame], expectation: str) -> None:
    """Predictions decide which places are evaluated twice, never a value near the surface."""
    field, frame = shipped
    metric = ObjectField.of(field, frame, torch.float32, 4096, bfloat16_band_m=0.02)
    x = (torch.rand(4000, 3, generator=torch.Generator().manual_seed(1)).double() - 0.5) * torch.tensor([5.0, 2.4, 2.0])
    exact = metric(x)
    expected = {
        "right": exact.double(),
        "wrong": 0.04 - exact.double(),
        "unknown": torch.full((4000,), torch.nan).double(),
        "all near": torch.zeros(4000).double(),
    }[expectation]
    metric.count.evaluations = metric.count.coarse = 0
    estimate = metric.estimate(x, expected)
    assert torch.equal(estimate[estimate < 0.02], exact[estimate < 0.02])
    assert torch.equal(estimate < 0, exact < 0)
    assert metric.count.evaluations == 4000
    assert (metric.count.coarse > 0) == (expectation in ("right", "unknown"))


@needs_bfloat16
def test_the_same_hits_with_and_without(shipped: tuple[Field, Frame]) -> None:
    field, frame = shipped
    beams = Beams.from_arrays(*sector_scan((13.0, 2.0, -1.0), half_angle_rad=0.17, rays=36))
    theta = torch.tensor([13.0, 2.0, -1.0, 0.8, 0.0, 0.0], dtype=torch.float64)
    with torch.no_grad():
        fine = render(beams, field, theta, frame, preset("standard").with_(bfloat16_band_m=0.0))
        coarse = render(beams, field, theta, frame, preset("standard"))
    assert fine.object_points > 200 and fine.coarse_evaluations == 0
    assert coarse.coarse_evaluations > 0.4 * coarse.evaluations
    assert int((fine.hit_mask ^ coarse.hit_mask).sum()) <= 1
    both = fine.hit_mask & coarse.hit_mask
    assert float((fine.range_m - coarse.range_m)[both].abs().quantile(0.98)) < 1e-3


def test_only_float32_decoders_have_a_bfloat16_copy() -> None:
    field = Decoder().folded().double().field(torch.zeros(256, dtype=torch.float64))
    assert field.rough is None
    for sdf in (Decoder().folded().field(torch.zeros(256)), lambda x: x[:, 0]):
        assert ObjectField.of(sdf, Frame(), torch.float64, 256, bfloat16_band_m=0.02).rough is None
        assert ObjectField.of(sdf, Frame(), torch.float32, 256).rough is None
    assert np.isfinite(preset("reference").bfloat16_band_m) and preset("reference").bfloat16_band_m == 0.0


@needs_bfloat16
@pytest.mark.parametrize("start_m", [-0.1, 0.15])
def test_it_comes_to_stand_where_it_touches(shipped: tuple[Field, Frame], start_m: float) -> None:
    field, frame = shipped
    fine, coarse = (ObjectField.of(field, frame, torch.float32, 4096, bfloat16_band_m=band) for band in (0.0, 0.02))
    size_m = torch.tensor(frame.size_m, dtype=torch.float64)
    ground = torch.cartesian_prod(torch.linspace(-3, 3, 60), torch.linspace(-2, 2, 40)).double()
    points = torch.cat((ground, torch.full((len(ground), 1), -1.73).double()), 1)
    theta = torch.tensor([0.0, 0.0, -1.73 + float(size_m[2]) / 2 + start_m, 0.3, 0.0, 0.0], dtype=torch.float64)
    found, exact = (snap_to_ground(metric, points, theta, size_m) for metric in (coarse, fine))
    assert found is not None and exact is not None
    assert coarse.count.coarse > 300
    with torch.no_grad():
        assert abs(float(fine(object_from_scene(points, found)).min())) <= 0.004
    assert torch.allclose(found, exact, atol=1e-3)
