"""What is carried along rays from one field to the next: expected where the lattice tells, no more sure than that."""

import torch
from shift3d.render.seen import Seen
from torch import Tensor

from shift3d.render.bounding_box import Box
from shift3d.render.culling import Rays
from shift3d.render.ray_samples import Profile
from shift3d.render.sdf_grid import FieldLattice

BOX = Box(torch.tensor([-3.0, -1.5, -1.5], dtype=torch.float64), torch.tensor([3.0, 1.5, 1.5], dtype=torch.float64))


def along_x(y: list[float], index: list[int], near: float = 0.0, far: float = 4.0) -> Rays:
    """Rays in +x from x = -2, at some y."""
    origins = torch.tensor([[-2.0, at, 0.0] for at in y], dtype=torch.float64)
    directions = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(len(y), 3)
    one = torch.ones(len(y), dtype=torch.float64)
    return Rays(torch.tensor(index), origins, directions, near * one, far * one)


def linear(lift: float, tilt: float = 0.0):  # type: ignore[no-untyped-def]
    return lambda x: 0.4 * x[:, 0] + 0.2 * x[:, 1] + lift + tilt * x[:, 1]


def profile_of(rays: Rays, field, ranges: list[float]) -> Profile:  # type: ignore[no-untyped-def]
    rows = torch.arange(len(rays)).repeat_interleave(len(ranges))
    k = torch.tensor(ranges, dtype=torch.float64).repeat(len(rays))
    g = field(rays.at(k, rows))
    return Profile(rows, k, g, torch.zeros_like(g))


def same(found: Tensor, expected: Tensor) -> None:
    assert float((found - expected).abs().max()) < 5e-6


def test_a_field_that_rises_evenly_is_expected_exactly_but_never_for_sure() -> None:
    rays = along_x([0.0, 0.3], [7, 9])
    before, after = linear(0.1), linear(0.35)
    profile = profile_of(rays, before, [0.5, 1.0, 3.5])
    lattices = FieldLattice.of(before, BOX), FieldLattice.of(after, BOX)
    carried = profile.carried(rays, rays, torch.tensor([0, 1]), *lattices)
    same(carried.g, after(rays.at(carried.k, carried.rows)))
    assert (carried.slack > 0).all() and float(carried.slack.max()) < 1e-4


def test_rays_that_have_moved_and_changed_their_numbers() -> None:
    rays, moved = along_x([0.0, 0.3], [7, 9]), along_x([0.33, -0.5], [9, 4])
    field = linear(0.1)
    lattice = FieldLattice.of(field, BOX)
    carried = profile_of(rays, field, [0.5, 1.0]).carried(rays, moved, torch.tensor([-1, 0]), lattice, lattice)
    assert carried.rows.tolist() == [0, 0] and carried.k.tolist() == [0.5, 1.0]
    same(carried.g, field(moved.at(carried.k, carried.rows)))
    assert (carried.slack >= 0.3 * 0.03).all(), "what has moved is not sure"


def test_an_uneven_change_makes_samples_unsure_and_it_adds_up() -> None:
    rays = along_x([0.1], [0])
    fields = [linear(0.1), linear(0.1, 0.2), linear(0.1, 0.4)]
    lattices = [FieldLattice.of(field, BOX) for field in fields]
    once = profile_of(rays, fields[0], [1.0]).carried(rays, rays, torch.tensor([0]), lattices[0], lattices[1])
    twice = once.carried(rays, rays, torch.tensor([0]), lattices[1], lattices[2])
    assert 0.02 < float(once.slack) < 0.04 and abs(float(twice.slack) - 2.0 * float(once.slack)) < 1e-5
    same(twice.g, fields[2](rays.at(twice.k, twice.rows)))


def test_samples_at_an_end_stay_at_it_and_those_far_beyond_are_gone() -> None:
    rays, shorter = along_x([0.0], [0]), along_x([0.0], [0], near=0.53, far=3.97)
    field = linear(0.1)
    lattice = FieldLattice.of(field, BOX)
    carried = profile_of(rays, field, [0.1, 0.5, 1.0, 4.0]).carried(rays, shorter, torch.tensor([0]), lattice, lattice)
    assert carried.k.tolist() == [0.53, 1.0, 3.97]
    same(carried.g, field(shorter.at(carried.k, carried.rows)))


def test_of_two_samples_at_one_place_the_new_one_stays() -> None:
    one = torch.ones(1, dtype=torch.float64)
    old, new = Profile(torch.tensor([2]), one, 5 * one, one), Profile(torch.tensor([2]), one, 3 * one, 0 * one)
    both = old.with_more(new)
    assert both.g.tolist() == [3.0] and both.slack.tolist() == [0.0]
    apart = old.with_more(Profile(torch.tensor([1, 2]), torch.cat((9 * one, 0.5 * one)), *[torch.cat((one, one))] * 2))
    assert apart.rows.tolist() == [1, 2, 2] and apart.k.tolist() == [9.0, 0.5, 1.0]


def test_what_a_march_saw_is_kept_but_for_what_is_no_number() -> None:
    seen, one = Seen(), torch.ones(3, dtype=torch.float64)
    seen.add(torch.tensor([0, 1, 1]), one, torch.tensor([0.1, torch.nan, 0.3], dtype=torch.float64))
    profile = Profile.of(seen, torch.tensor([4, 8]))
    assert profile.rows.tolist() == [4, 8] and profile.g.tolist() == [0.1, 0.3]
    assert len(Profile.of(Seen(), torch.tensor([4]))) == 0
