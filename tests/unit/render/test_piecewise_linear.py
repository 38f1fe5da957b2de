"""First crossings along linear pieces: the same with a bound on the slope, with none, and with a wrong one."""

import numpy as np
import pytest
import torch
from analytic_fields import Frame, sector_scan
from torch import Tensor

from shift3d.render import Beams, preset, render
from shift3d.sdf.field import Field

THETA = torch.tensor([12.0, 1.0, -0.5, 0.4, 0.0, 0.0], dtype=torch.float64)
FRAME = Frame((4.0, 1.8, 1.5), scale_m=2.5)
EXACT = preset("reference")


def plate(low: float, high: float, steepness: float = 1.0) -> Field:
    """Return a plate low <= y <= high, sdf units, as a ReLU network: steepness * (|y - centre| - half thickness)."""
    centre, half = (low + high) / 2, (high - low) / 2
    weight = torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
    bias = torch.tensor([-centre, centre], dtype=torch.float64)
    out = torch.full((1, 2), steepness, dtype=torch.float64)
    return Field([weight, out], [bias, torch.tensor([-half * steepness], dtype=torch.float64)], skip_layer=-1)


def beams() -> Beams:
    return Beams.from_arrays(*sector_scan((12.0, 1.0, -0.5), half_angle_rad=0.2, rays=24))


def expected_range(scan: Beams, face: float) -> Tensor:
    """Return the range of each beam to the plane y_object = face (m) of the object at THETA; infinite without a hit."""
    cos, sin = np.cos(0.4), np.sin(0.4)
    normal = torch.tensor([-sin, cos, 0.0], dtype=torch.float64)
    start = (scan.origins - THETA[:3]) @ normal
    fall = scan.directions @ normal
    k = (face - start) / fall
    return torch.where(k > 0, k, torch.inf)


@pytest.mark.parametrize("thickness_m", [0.3, 0.01, 1e-4, 1e-7])
def test_no_plate_is_too_thin(thickness_m: float) -> None:
    scan = beams()
    field = plate(0.0, thickness_m / FRAME.scale_m)
    with torch.no_grad():
        found = render(scan, field, THETA, FRAME, EXACT)
        every_piece = render(scan, field, THETA, FRAME, EXACT.with_(max_slope=float("inf")))
    hits = found.hit_mask
    assert hits.sum() > 100
    assert torch.equal(hits, every_piece.hit_mask)
    # The sensor is on one side or the other: the nearer face is hit.
    nearer = torch.minimum(expected_range(scan, 0.0), expected_range(scan, thickness_m))
    assert torch.allclose(found.range_m[hits], nearer[hits], atol=1e-8)
    assert torch.allclose(found.range_m, every_piece.range_m, atol=1e-8)


@pytest.mark.parametrize("steepness", [1.0, 5.0, 40.0])
def test_a_bound_that_does_not_hold_is_noticed(steepness: float) -> None:
    scan = beams()
    field = plate(0.0, 0.02, steepness)
    with torch.no_grad():
        trusting = render(scan, field, THETA, FRAME, EXACT.with_(max_slope=1.0))
        every_piece = render(scan, field, THETA, FRAME, EXACT.with_(max_slope=float("inf")))
    assert every_piece.hit_mask.sum() > 100
    assert torch.equal(trusting.hit_mask, every_piece.hit_mask)
    assert torch.allclose(trusting.range_m, every_piece.range_m, atol=1e-8)


def test_a_sensor_inside_is_unresolved() -> None:
    scan = beams()
    here = torch.tensor([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    field = plate(-0.5, 0.5)
    with torch.no_grad():
        found = render(scan, field, here, FRAME, EXACT)
    assert not found.hit_mask.any()
    assert found.unresolved_beams == len(scan)


def test_a_field_of_nan_is_unresolved_and_moves_nothing() -> None:
    scan = beams()
    field = plate(0.0, 0.02)
    broken = Field(field.weights, [field.biases[0] * float("nan"), field.biases[1]], -1)
    with torch.no_grad():
        found = render(scan, broken, THETA, FRAME, EXACT)
    assert not found.hit_mask.any()
    assert found.unresolved_beams > 100
    assert torch.equal(found.points, scan.points)


def test_residuals_are_of_the_order_of_a_rounding() -> None:
    with torch.no_grad():
        found = render(beams(), plate(0.0, 0.02), THETA, FRAME, EXACT)
    assert found.max_residual_m < 1e-12
