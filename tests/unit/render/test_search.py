"""Warm starts and SDF grids: cheaper, and the same picture."""

import pytest
import torch
from analytic_fields import (
    SHAPENET_FRAME,
    Frame,
    box,
    car,
    ground_scan,
    in_frame,
    rounded,
    sector_scan,
    sphere,
    union,
    wall_with_a_bump,
)

from shift3d.render import Beams, Rendering, SdfGrid, preset, render
from shift3d.sdf.decoder import load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles

STANDARD = preset("standard").with_(dtype=torch.float64)
THETA = torch.tensor([9.0, 3.0, -0.98, 0.5, 0.0, 0.0], dtype=torch.float64)


def scan() -> Beams:
    return Beams.from_arrays(*ground_scan(rings=64, columns=1024))


def same(a: Rendering, b: Rendering) -> None:
    # At the limb a warm hit may be on a chord below the 2 cm that a cold march is sure to find.
    differs = (a.hit_mask ^ b.hit_mask) | ((a.range_m - b.range_m).abs() > 1e-3)
    assert int(differs.sum()) <= 0.003 * b.object_points


def test_the_same_again_costs_less_than_a_third() -> None:
    beams, field = scan(), in_frame(car(), SHAPENET_FRAME)
    cold = render(beams, field, THETA, SHAPENET_FRAME, STANDARD)
    warm = render(beams, field, THETA, SHAPENET_FRAME, STANDARD, cold.warm)
    same(warm, cold)
    # A hit is evaluated once, and again if a local minimum or a ledge is in front of it; 26 beams skim the surface by
    # less than 3 mm and are always marched, and their local minima searched.
    assert warm.evaluations * 3 < cold.evaluations
    assert warm.evaluations <= cold.object_points * 4.5


def test_a_shape_that_changes_step_by_step() -> None:
    beams, warm = scan(), None
    spent, fresh = 0, 0
    for step in range(8):
        shape = in_frame(rounded(car(), 0.004 * step), SHAPENET_FRAME)
        followed = render(beams, shape, THETA, SHAPENET_FRAME, STANDARD, warm)
        cold = render(beams, shape, THETA, SHAPENET_FRAME, STANDARD)
        same(followed, cold)
        warm = followed.warm
        spent, fresh = spent + followed.evaluations, fresh + cold.evaluations
    assert spent < 0.7 * fresh


def test_a_pose_that_changes_step_by_step_with_and_without_a_grid() -> None:
    beams, field = scan(), in_frame(car(), SHAPENET_FRAME)
    grid = SdfGrid.of(field, SHAPENET_FRAME, STANDARD)
    warm = mapped = None
    for step in range(5):
        theta = THETA + step * torch.tensor([0.06, -0.03, 0.002, 0.04, 0.005, -0.004], dtype=torch.float64)
        cold = render(beams, field, theta, SHAPENET_FRAME, STANDARD)
        followed = render(beams, field, theta, SHAPENET_FRAME, STANDARD, warm)
        leapt = render(beams, field, theta, SHAPENET_FRAME, STANDARD, mapped, grid)
        same(followed, cold)
        same(leapt, cold)
        warm, mapped = followed.warm, leapt.warm
        assert leapt.evaluations < cold.evaluations


def test_a_surface_that_appears_in_front_is_found() -> None:
    # A plate rises from the hood in steps until it hides the cabin behind it.
    beams, warm = scan(), None
    for step in range(16):
        plate = box((0.03, 0.6, 0.01 + 0.02 * step), (1.6, 0.0, 0.2))
        shape = in_frame(union(car(), plate), SHAPENET_FRAME)
        followed = render(beams, shape, THETA, SHAPENET_FRAME, STANDARD, warm)
        warm = followed.warm
    cold = render(beams, shape, THETA, SHAPENET_FRAME, STANDARD)
    wrong = (followed.range_m - cold.range_m).abs() > 0.02
    assert int(wrong.sum()) <= 0.02 * cold.object_points


def test_a_jump_to_another_shape_or_place_is_searched_again() -> None:
    beams = scan()
    first = render(beams, in_frame(car(), SHAPENET_FRAME), THETA, SHAPENET_FRAME, STANDARD)
    other = in_frame(sphere(0.7), SHAPENET_FRAME)
    same(
        render(beams, other, THETA, SHAPENET_FRAME, STANDARD, first.warm),
        render(beams, other, THETA, SHAPENET_FRAME, STANDARD),
    )
    away = torch.tensor([-12.0, -3.0, -0.98, 2.0, 0.0, 0.0], dtype=torch.float64)
    field = in_frame(car(), SHAPENET_FRAME)
    same(
        render(beams, field, away, SHAPENET_FRAME, STANDARD, first.warm),
        render(beams, field, away, SHAPENET_FRAME, STANDARD),
    )


def test_warm_starts_from_nothing_hit() -> None:
    beams = scan()
    nothing = in_frame(lambda x: torch.full_like(x[:, 0], 0.2), SHAPENET_FRAME)
    first = render(beams, nothing, THETA, SHAPENET_FRAME, STANDARD)
    assert first.object_points == 0 and first.max_residual_m == 0.0
    field = in_frame(car(), SHAPENET_FRAME)
    cold = render(beams, field, THETA, SHAPENET_FRAME, STANDARD)
    again = render(beams, nothing, THETA, SHAPENET_FRAME, STANDARD, cold.warm)
    assert again.object_points == 0
    # A shape that returns is found at once: without a hit the renderer has no bound on a surface's movement.
    same(render(beams, field, THETA, SHAPENET_FRAME, STANDARD, again.warm), cold)


def test_a_part_that_comes_up_where_no_beam_came_nearest() -> None:
    """One ball keeps each beam's lowest place while another grows into the beam elsewhere, 6 cm a step."""
    beams, warm, theta = scan(), None, torch.tensor([9.0, 0.0, -0.98, 1.57, 0.0, 0.0], dtype=torch.float64)
    for step in range(9):
        shape = in_frame(
            union(sphere(0.6, (1.2, 0.0, 0.0)), sphere(0.1 + 0.06 * step, (-1.2, 0.3, 0.2))), SHAPENET_FRAME
        )
        warm = render(beams, shape, theta, SHAPENET_FRAME, STANDARD, warm).warm
        followed, cold = (render(beams, shape, theta, SHAPENET_FRAME, STANDARD, start) for start in (warm, None))
        same(followed, cold)


def test_vehicles_that_change_by_centimetres_a_step_are_seen_as_a_fresh_search_sees_them() -> None:
    """The shipped decoder moves straight through its codes, with gradients: 5 steps, 3 to 20 cm each."""
    decoder, vehicles, scale = load_decoder(), baseline_vehicles(), 0.1
    start, end = (torch.from_numpy(vehicles[name].latent_code) for name in ("coupe", "suv"))
    vehicle, settings, beams = vehicles["coupe"], preset("standard"), scan()
    warm, hits, lost = None, 0, 0
    for step in range(6):
        code = (start + scale * step * (end - start)).requires_grad_()
        followed = render(beams, decoder.field(code), THETA, vehicle, settings, warm)
        with torch.no_grad():
            cold = render(beams, decoder.field(code), THETA, vehicle, settings)
        off = (followed.range_m.detach() - cold.range_m).abs() > 0.005
        lost += int((cold.hit_mask & (~followed.hit_mask | off)).sum())
        hits += cold.object_points
        warm = followed.warm
        assert followed.unresolved_beams == cold.unresolved_beams == 0
    assert warm is not None and warm.age > 0
    assert hits > 2500 and lost <= 0.0005 * hits


@pytest.mark.parametrize(
    ("aside_m", "rise", "narrow", "hits"),
    [(0.0, 0.024, 1.0, (20, 100)), (0.05, 0.024, 4.0, (1, 7)), (0.0, 0.16, 4.0, (20, 300))],
    ids=["met by many beams", "met by no eighth beam", "beyond the corrector's reach"],
)
def test_a_hidden_unit_that_is_on_at_some_hits_alone_is_kept(
    aside_m: float, rise: float, narrow: float, hits: tuple[int, int]
) -> None:
    """A wall has a bump in the path of some beams, between the places that a search surveys beforehand."""
    field, frame = wall_with_a_bump(rise, narrow, aside_m), Frame(scale_m=2.5)
    beams = Beams.from_arrays(*sector_scan((10.0, 0.0875, 0.075), half_angle_rad=0.02, rays=32, far_m=30.0))
    theta = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    found, whole = (render(beams, field, theta, frame, STANDARD.with_(live_units=live)) for live in (True, False))
    assert whole.object_points == len(beams) and hits[0] <= int((whole.range_m < 9.99).sum()) <= hits[1]
    assert torch.equal(found.hit_mask, whole.hit_mask)
    assert float((found.range_m - whole.range_m).abs().max()) < 1e-5
