"""Rays known in part: refinement finds the hit of a cold search, and samples only the unknown parts."""

import math

import pytest
import torch
from analytic_fields import Field, box, sphere, union
from hypothesis import given, settings
from hypothesis import strategies as st
from straight_rays import (
    FLOAT64,
    along_x,
    check_against_dense,
    chords,
    coarse,
    cold,
    crossings,
    field_of,
    is_found,
    samples_at,
)

from shift3d.render.culling import Box, Rays
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.refinement import Refinement, _Nodes, refine

BOX = Box(torch.tensor([-3.0, -2.0, -2.0], dtype=torch.float64), torch.tensor([3.0, 2.0, 2.0], dtype=torch.float64))


def refined(
    rays: Rays,
    before: Field,
    after: Field,
    hit_m: float = math.nan,
    settings: RenderSettings = FLOAT64,
) -> Refinement:
    """Refine rays in a field from samples of another field; `spent` counts the evaluations."""
    grids = [coarse(metric, BOX) for metric in (before, after)]
    seen = cold(rays, before).samples
    samples = seen.predicted(rays, rays, torch.arange(len(rays)), *grids, 0.5)
    field = field_of(after)
    found = refine(samples, rays, torch.full_like(rays.far_m, hit_m), field, settings)
    spent.append(field.count.evaluations)
    return found


spent: list[int] = []
PASSING = tuple(1.05 + 0.1 * n for n in range(8))


def test_what_has_not_changed_is_hardly_looked_at() -> None:
    rays = along_x(*PASSING)
    found = refined(rays, sphere(1.0), sphere(1.0))
    assert not is_found(found).any() and not found.open.any()
    assert spent[-1] <= 2, "the one that passes at 5 cm or less, at its lowest place"


def test_a_shape_that_moves_away_is_known_to_be_away() -> None:
    found = refined(along_x(*PASSING), sphere(1.0), sphere(0.8))
    assert not is_found(found).any() and spent[-1] <= 4


@pytest.mark.parametrize("radius", [1.1, 1.3, 1.6])
def test_a_shape_that_grows_over_rays_that_passed_it(radius: float) -> None:
    rays = along_x(*PASSING)
    found = refined(rays, sphere(1.0), sphere(radius))
    assert not found.open.any() and not found.undecided.any()
    check_against_dense(crossings(found, sphere(radius), rays), sphere(radius), rays)
    fresh = field_of(sphere(radius))
    refine(RaySamples.none(), rays, torch.full_like(rays.far_m, math.nan), fresh, FLOAT64)
    assert spent[-1] < fresh.count.evaluations


def test_a_part_that_comes_up_far_from_where_the_ray_came_nearest() -> None:
    def two(left: float) -> Field:
        return union(sphere(0.4, (1.5, 0.5, 0.0)), sphere(left, (-1.5, 1.0, 0.0)))

    rays = along_x(0.0)
    found = refined(rays, two(0.3), two(1.05))
    assert abs(float(crossings(found, two(1.05), rays)) - (1.5 - math.sqrt(1.05**2 - 1.0))) < 2e-3


def test_in_front_of_a_hit_that_is_known() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    rays, post = along_x(0.0), union(wall, box((0.1, 0.4, 1.0), (0.0, 0.0, 0.0)))
    found = refined(rays, wall, post, hit_m=4.7)
    assert abs(float(crossings(found, post, rays)) - 2.9) < 2e-3
    assert not is_found(refined(rays, wall, wall, hit_m=4.7)).any()
    assert not is_found(refined(rays, wall, box((0.3, 1.0, 1.0), (1.9, 0.0, 0.0)), hit_m=4.6)).any()
    assert spent[-1] <= 4, "a wall that comes nearer is a hit that has moved"


def test_between_a_plain_approach_and_its_hit_hardly_anything_is_asked() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    nearer = box((0.3, 1.0, 1.0), (1.98, 0.0, 0.0))
    assert not is_found(refined(along_x(0.0), wall, nearer, hit_m=4.68)).any() and spent[-1] <= 1
    # A wall that is nearly parallel to the beam is no plain approach.
    flat = box((2.0, 1.0, 1.0), (0.0, 1.02, 0.0))
    assert is_found(refined(along_x(0.0), flat, box((2.0, 1.0, 1.0), (0.0, 0.99, 0.0)), hit_m=2.0)).all()


def test_behind_the_last_sample_of_a_hit_that_was_lost() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    away = box((0.3, 1.0, 1.0), (2.4, 0.0, 0.0))
    found = refined(along_x(0.0), wall, away)
    assert abs(float(crossings(found, away, along_x(0.0))) - 5.1) < 2e-3


def test_what_is_no_number_is_undecided_and_what_starts_inside_stays_open() -> None:
    after = lambda x: torch.where(x[:, 1] > 1.2, math.nan, sphere(1.0)(x))  # noqa: E731
    found = refined(along_x(0.0, 1.3), sphere(1.0), after)
    assert found.undecided.tolist() == [False, True] and is_found(found).tolist() == [True, False]
    around = refined(along_x(1.5), sphere(1.0), sphere(4.5))
    assert around.open.all() and not is_found(around).any()


@settings(max_examples=30, deadline=None)
@given(
    first=st.tuples(st.floats(-1.5, 1.5), st.floats(-0.8, 0.8), st.floats(0.45, 0.9)),
    second=st.tuples(st.floats(-1.5, 1.5), st.floats(-0.8, 0.8), st.floats(0.45, 0.9)),
    moved=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2)),
)
def test_two_balls_of_which_one_moves_are_found_but_where_a_ray_grazes_them(
    first: tuple[float, float, float], second: tuple[float, float, float], moved: tuple[float, float, float]
) -> None:
    """The balls are no smaller than the spacing of the grid; predicted samples leave at most 5 cm of depth open."""

    def balls(shift: tuple[float, float, float]) -> Field:
        x, y, r = (a + b for a, b in zip(first, shift))
        return union(sphere(r, (x, y, 0.0)), sphere(second[2], (second[0], second[1], 0.0)))

    rays = along_x(*(0.15 * n for n in range(-6, 7)))
    before, after = balls((0.0, 0.0, 0.0)), balls(moved)
    found = refined(rays, before, after)
    root = crossings(found, after, rays)
    for row, stretches in enumerate(chords(after, rays)):
        first_m = stretches[0][0] if stretches else math.inf
        if bool(found.open[row]) or abs(float(root[row]) - first_m) < 3e-3 or float(root[row]) == first_m:
            continue
        assert float(root[row]) > first_m, "nothing is found in front of what is there"
        k = torch.arange(first_m, min(float(root[row]), 6.0), 1e-3, dtype=torch.float64)
        assert float(after(rays.at(k, torch.full((len(k),), row))).min()) > -0.05


def _balls(left: float, right: float) -> Field:
    """Return a ball on each side of the ray along x, which passes the left ball at 0.5 m - left, likewise the right."""
    return union(sphere(left, (-1.5, 0.5, 0.0)), sphere(right, (1.5, 0.5, 0.0)))


@pytest.mark.parametrize("lowers", [True, False])
def test_what_is_lower_than_was_predicted_lowers_the_other_predictions_of_its_ray(
    lowers: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both balls grow by 15 cm; error bounds cover 1 cm. Only the right ball, passed at 4 cm, is sampled."""
    if not lowers:
        lowering = _Nodes.with_measured

        def alone(nodes: _Nodes, at: torch.Tensor, g: torch.Tensor, count: int) -> _Nodes:
            measured = lowering(nodes, at, g, count)
            return _Nodes(nodes.rows, nodes.k, nodes.g.index_copy(0, at, g), measured.error, nodes.kind)

        monkeypatch.setattr(_Nodes, _Nodes.with_measured.__name__, alone)
    rays, after = along_x(0.0), _balls(0.4 + 0.15, 0.46 + 0.15)
    seen = samples_at(rays, _balls(0.4, 0.46), torch.arange(0.0, 6.01, 0.05))
    predicted = RaySamples(seen.rows, seen.k, seen.g, torch.full_like(seen.g, 0.01))
    found = refine(predicted, rays, torch.full_like(rays.far_m, math.nan), field_of(after), FLOAT64)
    left, right = (stretch[0] for stretch in chords(after, rays)[0])
    assert abs(float(crossings(found, after, rays)) - (left if lowers else right)) < 2e-3
