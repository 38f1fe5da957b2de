"""March and bisection in the box: the paper's hits, for the evaluations of its box."""

from __future__ import annotations

import pytest
import torch
from analytic_fields import Frame, car, in_frame, sector_scan, sphere

from shift3d.errors import InputError
from shift3d.render import Beams, Rendering, preset, render

FRAME = Frame(scale_m=2.5)
MARCH = preset("standard").with_(solver="march", max_iterations=30, dtype=torch.float64)
THETA = torch.tensor([12.0, 1.0, -0.5, 0.4, 0.0, 0.0], dtype=torch.float64)


@pytest.fixture(scope="module")
def beams() -> Beams:
    return Beams.from_arrays(*sector_scan((12.0, 1.0, -0.5), half_angle_rad=0.2, rays=60))


def drawn(beams: Beams, name: str = "", **changes: object) -> Rendering:
    settings = preset(name).with_(dtype=torch.float64) if name else MARCH
    return render(beams, in_frame(car(), FRAME), THETA, FRAME, settings.with_(**changes))


def test_a_sphere_is_hit_where_it_is() -> None:
    fan = Beams.from_arrays(*sector_scan((12.0, 1.0, -0.5), half_angle_rad=0.05, rays=20))
    found = render(fan, in_frame(sphere(0.7), FRAME), THETA, FRAME, MARCH)
    along = fan.directions @ THETA[:3]
    expected = along - (0.49 - (THETA[:3].square().sum() - along**2)).clamp_min(0).sqrt()
    assert found.object_points > 100
    assert float((found.range_m - expected)[found.hit_mask].abs().max()) < 1e-8


def test_it_finds_what_the_paper_finds_for_a_fraction_of_the_evaluations(beams: Beams) -> None:
    boxed, whole = drawn(beams, step_m=0.02), drawn(beams, "paper", step_m=0.02)
    both = boxed.hit_mask & whole.hit_mask
    assert int((boxed.hit_mask != whole.hit_mask).sum()) <= 0.01 * int(both.sum())
    same = (boxed.range_m - whole.range_m).abs() < 1e-7
    assert int((both & ~same).sum()) <= 0.01 * int(both.sum())
    assert boxed.evaluations < whole.evaluations / 10


def test_finer_steps_miss_less_and_cost_more(beams: Beams) -> None:
    truth = drawn(beams, "standard", step_m=0.002, tolerance_m=1e-9)
    missed, evaluations = [], []
    for step_m in (0.4, 0.1, 0.025):
        found = drawn(beams, step_m=step_m)
        off = truth.hit_mask & ~(found.hit_mask & ((found.range_m - truth.range_m).abs() < 0.01))
        missed.append(int(off.sum()))
        evaluations.append(found.evaluations)
    assert missed[0] > missed[1] > missed[2]
    assert evaluations[0] < evaluations[1] < evaluations[2]


def test_each_bisection_halves_the_depth_error(beams: Beams) -> None:
    exact = drawn(beams, step_m=0.1, max_iterations=40)
    for count in (4, 8):
        rough = drawn(beams, step_m=0.1, max_iterations=count)
        error = (rough.range_m - exact.range_m)[exact.hit_mask].abs()
        assert float(error.max()) <= 0.1 / 2**count * (1 + 1e-9)


def test_a_sensor_inside_the_object_is_unresolved() -> None:
    fan = Beams.from_arrays(*sector_scan((12.0, 0.0, 0.0), rays=5))
    inside = render(fan, in_frame(sphere(0.7), FRAME), torch.zeros(6, dtype=torch.float64), FRAME, MARCH)
    assert inside.unresolved_beams == 25 and inside.object_points == 0
    assert torch.equal(inside.points, fan.points)


def test_a_method_that_there_is_not_is_refused() -> None:
    for change in ({"solver": "nonsense"}, {"root": "nonsense"}):
        with pytest.raises(InputError, match="nonsense"):
            preset("standard").with_(**change)


@pytest.mark.parametrize("root", ["itp", "bisection"])
def test_every_root_method_gives_the_same_hits(beams: Beams, root: str) -> None:
    usual, other = drawn(beams, "standard"), drawn(beams, "standard", root=root)
    assert torch.equal(usual.hit_mask, other.hit_mask)
    # |g| or the bracket within the tolerance: at a slope of 0.2, the shallowest that counts, five times it.
    assert float((usual.range_m - other.range_m).abs().quantile(0.99)) < 1e-4
