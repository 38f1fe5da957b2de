"""Errors of a rendering against the truth, counted on handmade renderings; chords through a thin plate."""

from __future__ import annotations

import math

import pytest
import torch
from analytic_fields import Field, Frame, in_frame, sphere

from shift3d.accuracy_time.errors import TrueHits, chord_lengths, compare
from shift3d.render.culling import Rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.rendering import Rendering

FRAME = Frame(scale_m=2.5)


def rendering(ranges: dict[int, float], beams: int = 12) -> Rendering:
    """Return hits of some beams at these ranges; the others return from 40 m."""
    hit, range_m = torch.zeros(beams, dtype=torch.bool), torch.full((beams,), 40.0, dtype=torch.float64)
    for beam, found in ranges.items():
        hit[beam], range_m[beam] = True, found
    return Rendering(torch.zeros(beams, 3), hit, range_m, 0.0, 0, 0)


def metric(field: Field) -> ObjectField:
    return ObjectField.of(in_frame(field, FRAME), FRAME, torch.float64, 4096)


TRUTH = TrueHits(
    torch.tensor([1, 3, 4, 6, 9]),
    torch.tensor([10.0, 11.0, 12.0, 13.0, 14.0], dtype=torch.float64),
    torch.tensor([0.05, 0.019, 0.02, 0.05, 0.05], dtype=torch.float64),
)


def test_the_truth_itself_has_no_error() -> None:
    found = compare(TRUTH, rendering({1: 10.0, 3: 11.0, 4: 12.0, 6: 13.0, 9: 14.0}))
    expected = {"hits": 5, "thick_hits": 4, "missed": 0, "missed_thick": 0, "wrong": 0, "false": 0}
    assert found == {**expected, "depth_m": [0.0] * 5}


def test_every_kind_of_error_is_counted_once() -> None:
    # 1 correct to a millimetre; 3 (thin) and 6 (thick) missed; 4 on a surface 0.5 m behind; 9 just within 1 cm; 0 and 2
    # hit nothing real.
    found = compare(TRUTH, rendering({1: 10.001, 4: 12.5, 9: 13.9905, 0: 7.0, 2: 8.0}))
    assert [found[name] for name in ("missed", "missed_thick", "wrong", "false")] == [2, 1, 1, 2]
    assert found["depth_m"] == pytest.approx([0.001, 0.0095], abs=1e-12)


def test_nothing_found_misses_all_and_nothing_there_can_only_be_false() -> None:
    blind = compare(TRUTH, rendering({}))
    assert (blind["missed"], blind["missed_thick"], blind["depth_m"]) == (5, 4, [])
    none = torch.empty(0, dtype=torch.float64)
    assert compare(TrueHits(none.long(), none, none), rendering({5: 9.0}))["false"] == 1


@pytest.mark.parametrize("thickness_m", [0.005, 0.011, 0.02, 0.0341])
@pytest.mark.parametrize("angle", [0.0, 0.6, 1.2])
def test_the_chord_of_a_plate_is_its_thickness_over_the_cosine(thickness_m: float, angle: float) -> None:
    # A plate across x, met at an angle of incidence.
    def plate(x: torch.Tensor) -> torch.Tensor:
        return x[:, 0].abs() - thickness_m / 2

    direction = torch.tensor([[math.cos(angle), math.sin(angle), 0.0]], dtype=torch.float64)
    start = torch.tensor([[-0.3, 0.1, 0.0]], dtype=torch.float64)
    hit = torch.tensor([(0.3 - thickness_m / 2) / math.cos(angle)], dtype=torch.float64)
    rays = Rays(torch.tensor([0]), start, direction, torch.zeros(1), torch.full((1,), 9.0))
    expected = min(thickness_m / math.cos(angle), 0.05)
    assert float(chord_lengths(metric(plate), rays, hit)) == pytest.approx(expected, abs=1e-9)


def test_chords_are_measured_beam_by_beam_and_end_at_five_centimetres() -> None:
    # Parallel beams through a ball: 2 sqrt(r^2 - d^2), and one tangent beam.
    apart = torch.tensor([0.0, 0.9, 0.9999, 0.99999, 1.0], dtype=torch.float64)
    start = torch.stack((torch.full_like(apart, -2.0), apart, torch.zeros_like(apart)), 1)
    half = (1.0 - apart**2).clamp_min(0).sqrt()
    direction = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64).expand(5, 3)
    rays = Rays(torch.arange(5), start, direction, torch.zeros(5), torch.full((5,), 9.0))
    found = chord_lengths(metric(sphere(1.0)), rays, 2.0 - half)
    expected = (2 * half).clamp_max(0.05)
    assert torch.allclose(found, expected, atol=1e-3)
    assert found[0] == 0.05 and found[4] == 0.0
