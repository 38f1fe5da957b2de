"""Rays known in parts: what a fresh march would find is found, and only where it has to be looked for."""

import math

import pytest
import torch
from analytic_fields import Field, Frame, box, sphere, union
from hypothesis import given, settings
from hypothesis import strategies as st
from shift3d.render.bracket import first_brackets
from shift3d.render.seen import Seen
from torch import Tensor

from shift3d.render.bounding_box import Box
from shift3d.render.coverage import Covered, cover
from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.ray_samples import Profile
from shift3d.render.sdf_grid import FieldLattice
from shift3d.render.settings import STANDARD, RenderSettings

FLOAT64 = STANDARD.with_(dtype=torch.float64)
BOX = Box(torch.tensor([-3.0, -2.0, -2.0], dtype=torch.float64), torch.tensor([3.0, 2.0, 2.0], dtype=torch.float64))


def along_x(*offsets: float) -> Rays:
    """Rays in +x from x = -3, at some y."""
    origins = torch.tensor([[-3.0, y, 0.0] for y in offsets], dtype=torch.float64)
    one = torch.ones(len(offsets), dtype=torch.float64)
    directions = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(len(offsets), 3)
    return Rays(torch.arange(len(offsets)), origins, directions, 0 * one, 6 * one)


def field_of(metric: Field) -> ObjectField:
    return ObjectField.of(metric, Frame(), torch.float64, 4096)


def marched(rays: Rays, metric: Field) -> Profile:
    """What a march leaves of these rays in front of their hits."""
    seen = Seen()
    brackets = first_brackets(rays, field_of(metric), FLOAT64, None, seen)
    return Profile.of(seen, torch.arange(len(rays))).before(torch.where(brackets.found, brackets.inner, torch.inf))


def covered(
    rays: Rays,
    before: Field,
    after: Field,
    hit_m: float = math.nan,
    settings: RenderSettings = FLOAT64,
) -> Covered:
    """Cover rays in a field, from what was seen of another; the evaluations that it took stand in `spent`."""
    lattices = [FieldLattice.of(metric, BOX) for metric in (before, after)]
    every = torch.arange(len(rays))
    profile = Profile.none().with_more(marched(rays, before)).carried(rays, rays, every, *lattices)
    field = field_of(after)
    found = cover(profile, rays, torch.full_like(rays.far_m, hit_m), field, settings)
    spent.append(field.count.evaluations)
    return found


spent: list[int] = []


def roots(found: Covered, metric: Field, rays: Rays) -> Tensor:
    """(M,) where brackets enter, to a millimetre; infinite without one."""
    brackets, entry = found.brackets, torch.full_like(rays.far_m, torch.inf)
    for row in torch.nonzero(brackets.found).squeeze(1).tolist():
        assert float(brackets.g_outer[row]) >= 0 > float(brackets.g_inner[row])
        k = torch.arange(float(brackets.outer[row]), float(brackets.inner[row]) + 1e-3, 1e-3, dtype=torch.float64)
        inside = metric(rays.at(k, torch.full((len(k),), row))) < 0
        entry[row] = k[inside.byte().argmax()] if inside.any() else brackets.inner[row]
    return entry


def true_entries(metric: Field, rays: Rays) -> tuple[Tensor, Tensor]:
    """(M,) where rays first enter, by samples every millimetre, and how long they stay inside."""
    k = torch.arange(0.0, 6.0, 1e-3, dtype=torch.float64)
    inside = torch.stack([metric(rays.at(k, torch.full((len(k),), row))) < 0 for row in range(len(rays))])
    first = inside.byte().argmax(1)
    until = (~inside & (torch.arange(len(k)) > first[:, None])).byte().argmax(1)
    return torch.where(inside.any(1), k[first], torch.inf), (until - first) * 1e-3


PASSING = tuple(1.05 + 0.1 * n for n in range(8))


def test_what_has_not_changed_is_hardly_looked_at() -> None:
    rays = along_x(*PASSING)
    found = covered(rays, sphere(1.0), sphere(1.0))
    assert not found.brackets.found.any() and not found.given_up.any()
    assert spent[-1] <= 2, "the one that passes at 5 cm or less, at its lowest place"


def test_a_shape_that_moves_away_is_known_to_be_away() -> None:
    found = covered(along_x(*PASSING), sphere(1.0), sphere(0.8))
    assert not found.brackets.found.any() and spent[-1] <= 4


@pytest.mark.parametrize("radius", [1.1, 1.3, 1.6])
def test_a_shape_that_grows_over_rays_that_passed_it(radius: float) -> None:
    rays = along_x(*PASSING)
    found = covered(rays, sphere(1.0), sphere(radius))
    entry, chord = true_entries(sphere(radius), rays)
    thick = chord >= 0.05
    assert not found.given_up.any() and not found.brackets.undecided.any()
    assert float((roots(found, sphere(radius), rays) - entry)[thick].abs().max()) < 2e-3
    fresh = field_of(sphere(radius))
    first_brackets(rays, fresh, FLOAT64)
    assert spent[-1] < fresh.count.evaluations


@pytest.mark.parametrize("radius", [1.02, 1.12])
def test_between_spheres_no_more_is_left_open_than_is_allowed(radius: float) -> None:
    evaluations = []
    for gap_m in (0.0, 0.05, 0.5):
        allowed = FLOAT64.with_(warm_gap_m=gap_m)
        found = covered(along_x(*PASSING), sphere(1.0), sphere(radius), settings=allowed)
        left = found.profile
        covers = FLOAT64.step_safety * (left.g - left.slack).clamp_min(0.0)
        same = left.rows[1:] == left.rows[:-1]
        gap = (left.k[1:] - left.k[:-1] - covers[1:] - covers[:-1])[same]
        assert same.any() and float(gap.max()) <= FLOAT64.step_m + gap_m + 1e-9
        assert torch.equal(found.brackets.found, torch.tensor(PASSING) < radius)
        evaluations.append(spent[-1])
    assert evaluations[0] >= evaluations[1] >= evaluations[2] and evaluations[0] > evaluations[2]


def test_a_part_that_comes_up_far_from_where_the_ray_came_nearest() -> None:
    def two(left: float) -> Field:
        return union(sphere(0.4, (1.5, 0.5, 0.0)), sphere(left, (-1.5, 1.0, 0.0)))

    rays = along_x(0.0)
    found = covered(rays, two(0.3), two(1.05))
    assert abs(float(roots(found, two(1.05), rays)) - (1.5 - math.sqrt(1.05**2 - 1.0))) < 2e-3


def test_in_front_of_a_hit_that_is_known() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    rays, post = along_x(0.0), union(wall, box((0.1, 0.4, 1.0), (0.0, 0.0, 0.0)))
    found = covered(rays, wall, post, hit_m=4.7)
    assert abs(float(roots(found, post, rays)) - 2.9) < 2e-3
    assert not covered(rays, wall, wall, hit_m=4.7).brackets.found.any()
    assert not covered(rays, wall, box((0.3, 1.0, 1.0), (1.9, 0.0, 0.0)), hit_m=4.6).brackets.found.any()
    assert spent[-1] <= 4, "a wall that comes nearer is a hit that has moved"


def test_between_a_plain_approach_and_its_hit_nothing_is_asked() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    nearer = box((0.3, 1.0, 1.0), (1.98, 0.0, 0.0))
    assert not covered(along_x(0.0), wall, nearer, hit_m=4.68).brackets.found.any() and spent[-1] == 0
    # A wall that the beam nearly runs along is no plain approach.
    flat = box((2.0, 1.0, 1.0), (0.0, 1.02, 0.0))
    assert covered(along_x(0.0), flat, box((2.0, 1.0, 1.0), (0.0, 0.99, 0.0)), hit_m=2.0).brackets.found.all()


def test_behind_the_last_sample_of_a_hit_that_was_lost() -> None:
    wall = box((0.3, 1.0, 1.0), (2.0, 0.0, 0.0))
    away = box((0.3, 1.0, 1.0), (2.4, 0.0, 0.0))
    found = covered(along_x(0.0), wall, away)
    assert abs(float(roots(found, away, along_x(0.0))) - 5.1) < 2e-3


def test_what_is_no_number_is_undecided_and_what_starts_inside_is_given_up() -> None:
    after = lambda x: torch.where(x[:, 1] > 1.2, math.nan, sphere(1.0)(x))  # noqa: E731
    found = covered(along_x(0.0, 1.3), sphere(1.0), after)
    assert found.brackets.undecided.tolist() == [False, True] and found.brackets.found.tolist()[1] is False
    around = covered(along_x(1.5), sphere(1.0), sphere(4.5))
    assert around.given_up.all() and not around.brackets.found.any()


@settings(max_examples=80, deadline=None)
@given(
    first=st.tuples(st.floats(-1.5, 1.5), st.floats(-0.8, 0.8), st.floats(0.45, 0.9)),
    second=st.tuples(st.floats(-1.5, 1.5), st.floats(-0.8, 0.8), st.floats(0.45, 0.9)),
    moved=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2)),
)
def test_two_balls_of_which_one_moves_are_found_but_where_a_ray_grazes_them(
    first: tuple[float, float, float], second: tuple[float, float, float], moved: tuple[float, float, float]
) -> None:
    """Balls no smaller than the spacing of the lattice; what expected samples leave open is 5 cm deep at most."""

    def balls(shift: tuple[float, float, float]) -> Field:
        x, y, r = (a + b for a, b in zip(first, shift))
        return union(sphere(r, (x, y, 0.0)), sphere(second[2], (second[0], second[1], 0.0)))

    rays = along_x(*(0.15 * n for n in range(-6, 7)))
    before, after = balls((0.0, 0.0, 0.0)), balls(moved)
    found = covered(rays, before, after)
    entry, _ = true_entries(after, rays)
    root = roots(found, after, rays)
    lost = ~((root - entry).abs() < 3e-3) & (root != entry) & ~found.given_up
    for row in torch.nonzero(lost).squeeze(1).tolist():
        assert float(root[row]) > float(entry[row]), "nothing is found in front of what is there"
        k = torch.arange(float(entry[row]), min(float(root[row]), 6.0), 1e-3, dtype=torch.float64)
        assert float(after(rays.at(k, torch.full((len(k),), row))).min()) > -0.05
