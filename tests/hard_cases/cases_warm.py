"""Renderer: warm starts: parts that moved away, came up, came near, or were never the same."""

from __future__ import annotations

import math

import numpy as np
import torch
from analytic_fields import Field, Frame, box, car, rounded, sector_scan, sphere, union, wall_with_a_bump
from catalogue import hard_case
from hard_scenes import AT_TEN, FAST, PLAIN, beams_along_x, draw, fan, hit_at, pose, unmoved
from torch import Tensor

from shift3d.render import Beams, Rendering, render
from shift3d.render.solvers.search import WarmStart

SPHERE, SLAB = sphere(1.0), box((0.2, 1.0, 0.5), (0.6, 0.0, 0.0))


def beams_at(*lateral_m: float) -> Beams:
    """Return beams in +x at these y."""
    y, zero = np.asarray(lateral_m), np.zeros(len(lateral_m))
    return Beams.from_arrays(np.stack([zero + 30.0, y, zero], 1), np.stack([zero, y, zero], 1))


def again(beams: Beams, metric: Field, before: Rendering, theta: Tensor = AT_TEN) -> Rendering:
    """Render from another rendering, with a gradient as in an attack."""
    return draw(beams, metric, theta.clone().requires_grad_(), warm=before.warm, frame=PLAIN)


def as_cold(found: Rendering, beams: Beams, metric: Field, theta: Tensor = AT_TEN, tolerance_m: float = 1e-4) -> None:
    """Check that a rendering equals that of a cold search."""
    cold = draw(beams, metric, theta, frame=PLAIN)
    assert found.hit_mask.tolist() == cold.hit_mask.tolist()
    assert float((found.range_m.detach() - cold.range_m).abs().max()) <= tolerance_m


@hard_case(
    area="renderer",
    why="a surface that is followed moves behind the return of its beam",
    must="the return stays",
    guard="a followed root counts on the stretch of its beam alone",
)
def a_followed_surface_that_moves_behind_the_return() -> None:
    beams = beams_along_x(end_x=9.3)
    first = draw(beams, box((0.72, 0.5, 0.5)), frame=PLAIN)
    hit_at(first, 9.28)
    unmoved(again(beams, box((0.69, 0.5, 0.5)), first), beams)


@hard_case(
    area="renderer",
    why="a post slides out of a beam's way between two steps: the hit vanishes, the wall behind takes over",
    must="the wall is hit, in the very step",
    guard="the ray of a hit that cannot be followed is covered to its end",
)
def a_followed_hit_that_vanishes() -> None:
    beams, before = beams_at(0.0, -0.9), None
    for y in (0.0, 0.05, 0.1, 0.2, 0.4):
        metric = union(box((0.1, 0.15, 0.5), (-0.6, y, 0.0)), SLAB)
        before = draw(beams, metric, frame=PLAIN) if before is None else again(beams, metric, before)
        assert abs(float(before.range_m.detach()[0]) - (9.3 if y < 0.15 else 10.4)) < 1e-4, y


@hard_case(
    area="renderer",
    why="the slope of the last rendering leads a followed beam through a thin plate into the wall behind",
    must="the plate is hit",
    guard="a root farther than 30 cm from where the hit was does not count, and the way to a nearer one is covered",
)
def a_followed_hit_that_overshoots() -> None:
    def plate(at: float, steepness: float) -> Field:
        both = union(box((0.01, 0.5, 0.5), (at, 0.0, 0.0)), box((1.0, 0.5, 0.5), (1.3895, 0.0, 0.0)))
        return lambda x: steepness * both(x)

    beams = beams_along_x()
    first = draw(beams, plate(0.0, 0.1), frame=PLAIN)
    hit_at(first, 9.99)
    hit_at(again(beams, plate(0.04, 1.0), first), 10.03)


@hard_case(
    area="renderer",
    why="a limb creeps towards a beam that passes it, and moves along the beam meanwhile",
    must="the beam hits in the step in which a fresh search says so",
    guard="a passing beam is looked at where it came nearest, and wherever what is expected no longer covers it",
)
def a_beam_that_starts_to_hit() -> None:
    beams, before = beams_at(1.04, 0.0), None
    for step in range(14):
        metric = sphere(1.0 + 0.005 * step, (0.02 * step, 0.0, 0.0))
        before = draw(beams, metric, frame=PLAIN) if before is None else again(beams, metric, before)
        as_cold(before, beams, metric, tolerance_m=1e-3)
    assert before is not None and before.hit_mask.all()


@hard_case(
    area="renderer",
    why="as the pose moves, the box takes in beams of which the last rendering knew nothing",
    must="they are searched, and hit once the object stands in their way",
    guard="a beam of which nothing is known is covered from end to end",
)
def a_beam_that_enters_the_box() -> None:
    metric, beams = box((2.0, 0.9, 0.7)), beams_at(0.98, 0.0)
    before = draw(beams, metric, frame=PLAIN)
    assert before.hit_mask.tolist() == [False, True]
    for step in range(1, 4):
        theta = pose(10.0, 0.04 * step)
        before = again(beams, metric, before, theta)
        as_cold(before, beams, metric, theta)
    assert before.hit_mask.all()


@hard_case(
    area="renderer",
    why="a bump rises from a ledge that a beam skims on its way down to its hit: the field has no local minimum",
    must="the bump is hit, in the very step",
    guard="the lowest place in front of a hit is looked at, whatever is expected there",
)
def a_bump_that_rises_from_a_shelf() -> None:
    def wall_behind_a_shelf(bump_top_m: float) -> Field:
        block, bump = box((0.3, 0.5, 0.25), (0.1, 0.0, -0.25)), box((0.045, 0.5, 0.1), (0.315, 0.0, bump_top_m - 0.1))
        both = union(SLAB, bump)

        def field(x: Tensor) -> Tensor:
            # The shelf rises towards the wall: the beam, at height 0, is 8 cm above its start and 2 cm above its end.
            below_top = (x[:, 2] + 0.02 - 0.1 * (x[:, 0] - 0.4)) / math.hypot(1.0, 0.1)
            return torch.minimum(torch.maximum(below_top, block(x)), both(x))

        return field

    beams = beams_along_x()
    first = draw(beams, wall_behind_a_shelf(-0.05), frame=PLAIN)
    hit_at(first, 10.4)
    hit_at(again(beams, wall_behind_a_shelf(0.01), first), 10.27)


@hard_case(
    area="renderer",
    why="a pea appears out of nothing in front of a hit that can be followed, amid the points of the coarse lattice",
    must="it is found after `warm_refresh` renderings at the latest",
    guard="after so many warm renderings everything is searched",
)
def a_surface_that_appears_in_front_of_a_followed_hit() -> None:
    ends, starts = np.array([[30.0, 0.225, 0.225]]), np.array([[0.0, 0.225, 0.225]])
    beams = Beams.from_arrays(ends, starts)
    before = draw(beams, SLAB, frame=PLAIN)
    hit_at(before, 10.4)
    metric = union(SLAB, sphere(0.02, (0.25, 0.225, 0.225)))
    for _ in range(FAST.warm_refresh + 1):
        before = again(beams, metric, before)
    as_cold(before, beams, metric)
    hit_at(before, 10.23)


@hard_case(
    area="renderer",
    why="a pose that jumps puts other parts of the object before every beam",
    must="what a fresh search finds",
    guard="a pose that moved by more than 5 cm is searched afresh, and samples are expected elsewhere",
)
def a_pose_that_jumps() -> None:
    here, there = pose(10.0, 0.0, 0.0, 0.2), pose(9.6, 0.5, 0.1, 1.4)
    beams = fan(here)
    first = draw(beams, car(), here, frame=PLAIN)
    as_cold(again(beams, car(), first, there), beams, car(), there, tolerance_m=1e-3)


@hard_case(
    area="renderer",
    why="after a rendering without a hit nothing tells how far the surface has moved",
    must="a shape that comes back is hit at once",
    guard="without a hit to follow everything is searched",
)
def a_shape_that_comes_back() -> None:
    beams = beams_at(0.0, 0.5)
    gone = draw(beams, lambda x: torch.full_like(x[:, 0], 0.2), frame=PLAIN)
    unmoved(gone, beams)
    as_cold(again(beams, SPHERE, gone), beams, SPHERE)


@hard_case(
    area="renderer",
    why="a shape that grows by centimetres a step leaves the box that was checked for its ancestor",
    must="beams above the old box hit it",
    guard="the box's check points are looked at again as far as the surface has moved",
)
def a_shape_that_outgrows_its_box_step_by_step() -> None:
    beams = Beams.from_arrays(np.array([[30.0, 0.0, 0.85], [30.0, 0.0, 0.0]]), np.array([[0, 0, 0.85], [0, 0, 0.0]]))
    before = draw(beams, car(), frame=PLAIN)
    assert before.hit_mask.tolist() == [False, True]
    for step in range(1, 6):
        grown = rounded(car(), 0.03 * step)
        before = again(beams, grown, before)
        as_cold(before, beams, grown, tolerance_m=1e-3)
    assert before.hit_mask.all()


@hard_case(
    area="renderer",
    why="a field that turns NaN beside a beam that passes the object says nothing about its clearance",
    must="the beam is looked at, and counted as unresolved",
    guard="what is not surely covered is looked at",
)
def a_field_that_turns_nan() -> None:
    beams = beams_at(0.0, 1.3)
    first = draw(beams, SPHERE, settings=FAST.with_(box_margin_m=0.6), frame=PLAIN)
    assert first.hit_mask.tolist() == [True, False]
    found = again(beams, lambda x: torch.where(x[:, 1] > 1.2, math.nan, SPHERE(x)), first)
    assert found.hit_mask.tolist() == [True, False] and found.unresolved_beams == 1


@hard_case(
    area="renderer",
    why="a rendering of another scene knows other beams under the same numbers",
    must="what a fresh search finds",
    guard="a warm start is used for the very beams that it is of",
)
def a_warm_start_from_another_scene() -> None:
    ends = np.array([[30.0, 1.5, 0.0], [30.0, 0.0, 0.0]])
    here = Beams.from_arrays(ends, np.array([[0.0, 1.5, 0.0], [0.0, 0.0, 0.0]]))
    ends[0, 1] = 0.0
    there = Beams.from_arrays(ends, np.array([[-1.4, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    wide = union(SPHERE, box((0.1, 0.4, 0.1), (0.0, 1.3, 0.6)))
    first = draw(here, wide, settings=FAST.with_(box_margin_m=0.8), frame=PLAIN)
    assert first.hit_mask.tolist() == [False, True]
    as_cold(again(there, wide, first), there, wide)
    longer = Beams.from_arrays(np.array([[30.0, 0.1 * y, 0.0] for y in range(7)]), np.zeros(3))
    as_cold(again(longer, SPHERE, draw(here, SPHERE, frame=PLAIN)), longer, SPHERE)


@hard_case(
    area="renderer",
    why="a last short step of a followed hit is left to whoever takes the gradient, and nobody takes one here",
    must="every root is as good as the tolerance says",
    guard="without a gradient no step is left unchecked",
)
def a_followed_hit_without_a_gradient() -> None:
    beams = beams_at(0.0, 0.5, 0.8, 0.95)
    first = draw(beams, SPHERE, frame=PLAIN)
    found = draw(beams, sphere(1.0003), warm=first.warm, frame=PLAIN)
    expected = 10.0 - (1.0003**2 - torch.tensor([0.0, 0.5, 0.8, 0.95]).double() ** 2).sqrt()
    assert found.hit_mask.all() and found.max_residual_m <= FAST.tolerance_m
    assert float((found.range_m - expected).abs().max()) < 2e-5


def fins(*steps: tuple[float, float]) -> None:
    """Check a fin on a car's side that grows through the side of the box, between a beam along that side and its hit.

    steps: half of the fin's thickness, and how far out it reaches. The box at first reaches 0.95; the beam passes over
    the fin at 1.0 and then hits the plate behind it.
    """

    def metric(thick: float, tip: float) -> Field:
        fin = box((thick, tip / 2, 0.3), (-0.5, tip / 2, 0.0))
        return union(box((1.7, 0.3, 0.4)), fin, box((0.1, 0.47, 0.3), (1.5, 0.46, 0.0)))

    # The first beam runs along the side, the second into the fin: its movement shows that things move.
    ends, starts = np.array([[12.0, 0.88, 0.0], [12.0, 0.55, 0.0]]), np.array([[0.0, 1.48, 0.0], [0.0, 0.55, 0.0]])
    beams, frame = Beams.from_arrays(ends, starts), Frame(size_m=(3.6, 1.8, 0.9), scale_m=2.5)
    found = draw(beams, metric(0.15, 0.9), frame=frame)
    assert found.hit_mask.all()
    before = found.range_m[0]
    for thick, tip in steps:
        grown = metric(thick, tip)
        found = draw(beams, grown, AT_TEN.clone().requires_grad_(), warm=found.warm, frame=frame)
        cold = draw(beams, grown, frame=frame)
        assert float((found.range_m.detach() - cold.range_m).abs().max()) < 1e-4
    assert float(before - found.range_m[0]) > 1.0, "in the end the fin hides the plate"


@hard_case(
    area="renderer",
    why="a fin grows through the side of the box, in front of what a beam hits that comes in through that side",
    must="the beam hits the fin at once",
    guard="what a grown box adds to a beam in front is covered too",
)
def a_fin_shoots_out_of_the_box_in_front_of_a_hit() -> None:
    fins((0.17, 0.92), (0.25, 1.05))


@hard_case(
    area="renderer",
    why="a fin grows out of the box slowly: when the box was grown for it, it did not yet reach the beam that it hides",
    must="the beam hits the fin in the very step that takes it there",
    guard="what was seen on the stretch that was added is carried along",
)
def a_fin_that_grows_out_of_the_box_in_front_of_a_hit() -> None:
    fins(*((0.15 + 0.02 * step, 0.9 + 0.02 * step) for step in range(1, 9)))


@hard_case(
    area="renderer",
    why="the pose moves away from the last beam that passed through the box",
    must="an empty rendering, none unresolved",
    guard="beams that are carried over may be none",
)
def the_last_beam_leaves_the_box() -> None:
    beams, metric = beams_at(0.94), box((2.0, 0.9, 0.7))
    first = draw(beams, metric, frame=PLAIN)
    unmoved(first, beams)
    unmoved(again(beams, metric, first, pose(10.0, -0.04)), beams)


@hard_case(
    area="renderer",
    why="a surface that is predicted to a millimetre moves just behind the return of its beam",
    must="the return stays",
    guard="a predicted root counts on the stretch of its beam alone",
)
def a_predicted_surface_that_moves_behind_the_return() -> None:
    beams, metric = beams_along_x(end_x=9.3), box((0.7005, 0.5, 0.5))
    first = draw(beams, metric, AT_TEN.clone().requires_grad_(), frame=PLAIN)
    hit_at(first, 9.2995)
    unmoved(again(beams, metric, first, pose(10.001)), beams)


@hard_case(
    area="renderer",
    why="a ball comes up in front of a wall whose hit was predicted",
    must="the ball is hit, and the gradient is that of its surface",
    guard="a tangent counts only at the very hit it was made at",
)
def a_predicted_hit_that_is_covered() -> None:
    def gradient(metric: Field, warm: WarmStart | None) -> tuple[Tensor, Rendering]:
        theta = AT_TEN.clone().requires_grad_()
        drawn = draw(beams, metric, theta, warm=warm, frame=PLAIN)
        drawn.points.sum().backward()
        assert theta.grad is not None
        return theta.grad, drawn

    def ball_at(y: float) -> Field:
        return union(SLAB, sphere(0.2, (-0.5, y, 0.0)))

    beams = beams_at(0.0)
    before = draw(beams, ball_at(-0.27), AT_TEN.clone().requires_grad_(), frame=PLAIN)
    hit_at(before, 10.4)
    warm, found = gradient(ball_at(-0.15), before.warm)
    cold, afresh = gradient(ball_at(-0.15), None)
    assert 9.3 < float(found.range_m) < 9.5 and torch.allclose(found.range_m, afresh.range_m, atol=1e-5)
    assert torch.allclose(warm, cold, atol=1e-4)


@hard_case(
    area="renderer",
    why="between two steps a decoder's unit that was off everywhere raises a bump that a few beams alone meet",
    must="these beams hit the bump",
    guard="every hit of a warm rendering is evaluated with every unit, and corrected if a unit was missing",
)
def a_unit_that_comes_on_between_two_steps() -> None:
    beams = Beams.from_arrays(*sector_scan((10.0, 0.0875, 0.075), half_angle_rad=0.02, rays=32, far_m=30.0))
    settings, theta = FAST, AT_TEN.clone().requires_grad_()
    before = render(beams, wall_with_a_bump(-0.01, 4.0, 0.05), theta, PLAIN, settings)
    for rise in (0.024, 0.03):
        field = wall_with_a_bump(rise, 4.0, 0.05)
        before = render(beams, field, theta, PLAIN, settings, before.warm)
        whole = render(beams, field, theta, PLAIN, settings.with_(live_units=False))
        assert before.warm is not None and before.warm.age > 0
        assert 0 < int((whole.range_m < 9.99).sum()) < 9
        assert float((before.range_m - whole.range_m).abs().max()) < 1e-5
