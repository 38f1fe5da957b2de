"""Samples carried along rays from one field to the next: predicted where the grid has values, with stated error."""

import itertools
import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from straight_rays import coarse
from torch import Tensor

from shift3d.render.culling import Box, Rays
from shift3d.render.solvers.ray_samples import RaySamples

BOX = Box(torch.tensor([-3.0, -1.5, -1.5], dtype=torch.float64), torch.tensor([3.0, 1.5, 1.5], dtype=torch.float64))


def along_x(y: list[float], index: list[int], near: float = 0.0, far: float = 4.0) -> Rays:
    """Return rays in +x from x = -2, at these y."""
    origins = torch.tensor([[-2.0, at, 0.0] for at in y], dtype=torch.float64)
    directions = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(len(y), 3)
    one = torch.ones(len(y), dtype=torch.float64)
    return Rays(torch.tensor(index), origins, directions, near * one, far * one)


def linear(lift: float, tilt: float = 0.0):  # type: ignore[no-untyped-def]
    return lambda x: 0.4 * x[:, 0] + 0.2 * x[:, 1] + lift + tilt * x[:, 1]


def samples_at(rays: Rays, field, ranges: list[float]) -> RaySamples:  # type: ignore[no-untyped-def]
    rows = torch.arange(len(rays)).repeat_interleave(len(ranges))
    k = torch.tensor(ranges, dtype=torch.float64).repeat(len(rays))
    g = field(rays.at(k, rows))
    return RaySamples(rows, k, g, torch.zeros_like(g))


def same(found: Tensor, expected: Tensor) -> None:
    assert float((found - expected).abs().max()) < 5e-6


def test_a_field_that_rises_evenly_is_expected_exactly_but_never_for_sure() -> None:
    rays = along_x([0.0, 0.3], [7, 9])
    before, after = linear(0.1), linear(0.35)
    profile = samples_at(rays, before, [0.5, 1.0, 3.5])
    grids = coarse(before, BOX), coarse(after, BOX)
    carried = profile.predicted(rays, rays, torch.tensor([0, 1]), *grids, 0.5)
    same(carried.g, after(rays.at(carried.k, carried.rows)))
    assert (carried.error > 0).all() and float(carried.error.max()) < 1e-4


def test_rays_that_have_moved_and_changed_their_numbers() -> None:
    rays, moved = along_x([0.0, 0.3], [7, 9]), along_x([0.33, -0.5], [9, 4])
    field = linear(0.1)
    grid = coarse(field, BOX)
    carried = samples_at(rays, field, [0.5, 1.0]).predicted(rays, moved, torch.tensor([-1, 0]), grid, grid, 0.5)
    assert carried.rows.tolist() == [0, 0] and carried.k.tolist() == [0.5, 1.0]
    same(carried.g, field(moved.at(carried.k, carried.rows)))
    assert (carried.error >= 0.3 * 0.03).all(), "what has moved is not sure"


def test_an_uneven_change_makes_samples_unsure_and_it_adds_up() -> None:
    rays = along_x([0.1], [0])
    fields = [linear(0.1), linear(0.1, 0.2), linear(0.1, 0.4)]
    grids = [coarse(field, BOX) for field in fields]
    once = samples_at(rays, fields[0], [1.0]).predicted(rays, rays, torch.tensor([0]), grids[0], grids[1], 0.5)
    twice = once.predicted(rays, rays, torch.tensor([0]), grids[1], grids[2], 0.5)
    assert 0.04 < float(once.error) < 0.05 and abs(float(twice.error) - 2.0 * float(once.error)) < 1e-5
    same(twice.g, fields[2](rays.at(twice.k, twice.rows)))


def test_samples_at_an_end_stay_at_it_and_those_far_beyond_are_gone() -> None:
    rays, shorter = along_x([0.0], [0]), along_x([0.0], [0], near=0.53, far=3.97)
    field = linear(0.1)
    grid = coarse(field, BOX)
    carried = samples_at(rays, field, [0.1, 0.5, 1.0, 4.0]).predicted(rays, shorter, torch.tensor([0]), grid, grid, 0.5)
    assert carried.k.tolist() == [0.53, 1.0, 3.97]
    same(carried.g, field(shorter.at(carried.k, carried.rows)))


def test_of_two_samples_at_one_place_the_new_one_stays() -> None:
    one = torch.ones(1, dtype=torch.float64)
    old, new = RaySamples(torch.tensor([2]), one, 5 * one, one), RaySamples(torch.tensor([2]), one, 3 * one, 0 * one)
    both = old.joined(new)
    assert both.g.tolist() == [3.0] and both.error.tolist() == [0.0]
    apart = old.joined(RaySamples(torch.tensor([1, 2]), torch.cat((9 * one, 0.5 * one)), *[torch.cat((one, one))] * 2))
    assert apart.rows.tolist() == [1, 2, 2] and apart.k.tolist() == [9.0, 0.5, 1.0]


@settings(max_examples=100, deadline=None)
@given(
    samples=st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 6.0), st.floats(0.0, 2.0)), max_size=60),
    spacing=st.sampled_from([0.01, 0.02, 0.1]),
)
def test_of_every_stretch_the_lowest_sample_is_kept(samples: list[tuple[int, float, float]], spacing: float) -> None:
    rows, k, g = zip(*samples, strict=True) if samples else ((), (), ())
    k, g = (torch.tensor(part, dtype=torch.float64) for part in (k, g))
    every = RaySamples.none().joined(RaySamples(torch.tensor(rows, dtype=torch.long), k, g, torch.zeros_like(g)))
    kept = every.thinned(spacing)
    lowest: dict[tuple[int, float, float], float] = {}
    for row, at, height in zip(every.rows.tolist(), every.k.tolist(), every.g.tolist(), strict=True):
        length = spacing * 2.0 ** math.floor(math.log2(max(1.0, height / (2 * spacing))))
        stretch = (row, length, math.floor(at / length))
        lowest[stretch] = min(lowest.get(stretch, math.inf), height)
    assert sorted(kept.g.tolist()) == sorted(lowest.values())
    # By ray, and by range to 0.1 um.
    places = list(zip(kept.rows.tolist(), kept.k.tolist(), strict=True))
    assert all(a[0] < b[0] or (a[0] == b[0] and a[1] <= b[1] + 1e-7) for a, b in itertools.pairwise(places))
    there = set(zip(every.rows.tolist(), every.k.tolist(), every.g.tolist(), strict=True))
    assert set(zip(kept.rows.tolist(), kept.k.tolist(), kept.g.tolist(), strict=True)) <= there
