"""What lies between the samples of a march is found where it dips to the surface, and taken for what it is."""

from dataclasses import replace

import torch
from analytic_fields import Field, Frame
from shift3d.render.bracket import Brackets, first_brackets
from shift3d.render.dips import look_into_dips
from shift3d.render.seen import Seen
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.settings import STANDARD

END = 10.0


def look(
    metric: Field, samples: list[float], crossing: tuple[float, float] | None = None, seen: Seen | None = None
) -> Brackets:
    """What comes of one ray along x that was sampled at these places; crossing: the bracket that it has already."""
    one, zero = torch.ones(1, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64)
    rays = Rays(torch.zeros(1, dtype=torch.long), zero, zero + torch.eye(3).double()[0], 0 * one, END * one)
    field = ObjectField.of(metric, Frame(), torch.float64, 4096)
    k = torch.tensor(samples, dtype=torch.float64)
    g = field(rays.at(k, torch.zeros(len(k), dtype=torch.long))).double()
    seen = Seen() if seen is None else seen
    seen.add(torch.zeros(len(k), dtype=torch.long), k, g)
    none = torch.zeros(1, dtype=torch.bool)
    before = Brackets(none, one, one, one, one, none)
    if crossing is not None:
        outer, inner = (torch.tensor([x], dtype=torch.float64) for x in crossing)
        g_outer, g_inner = (field(rays.at(x)).double() for x in (outer, inner))
        before = replace(before, found=~none, outer=outer, inner=inner, g_outer=g_outer, g_inner=g_inner)
    return look_into_dips(before, seen, rays, field)


def valley(at: float, depth: float, slope: float = 0.3) -> Field:
    """|x - at| slope - depth: below zero on a chord of 2 depth / slope."""
    return lambda x: slope * (x[:, 0] - at).abs() - depth


def lowest_of(*fields: Field) -> Field:
    def g(x: Tensor) -> Tensor:
        return torch.stack([field(x) for field in fields]).amin(0)

    return g


def test_the_first_of_several_dips_that_cross_is_the_crossing() -> None:
    metric = lowest_of(valley(2.013, -1e-4), valley(4.007, 2e-4), valley(6.0051, 3e-4))
    found = look(metric, [x / 50 for x in range(0, 400)])
    assert found.found.all() and not found.undecided.any()
    assert 3.99 < float(found.outer) < 4.007 - 2e-4 / 0.3 < float(found.inner) < 4.007 + 2e-4 / 0.3
    assert float(found.g_outer) > 0 > float(found.g_inner)


def test_a_dip_in_front_of_a_crossing_comes_first_and_one_behind_it_is_nothing() -> None:
    wall = valley(7.0, 0.3)
    in_front = look(lowest_of(valley(3.007, 2e-4), wall), [x / 50 for x in range(0, 310)], (5.98, 6.01))
    assert abs(float(in_front.inner) - 3.007) < 1e-3
    behind = look(lowest_of(valley(9.007, 2e-4), wall), [x / 50 for x in range(0, 460)], (5.98, 6.01))
    assert (float(behind.outer), float(behind.inner)) == (5.98, 6.01)


def test_a_sample_inside_that_a_march_passed_over_is_a_crossing() -> None:
    found = look(valley(5.0, 0.05), [1.0, 3.0, 4.5, 5.05, 6.0])
    assert found.found.all() and (float(found.outer), float(found.inner)) == (4.5, 5.05)


def test_dips_that_do_not_reach_the_surface_are_no_hits_and_their_bottoms_are_seen() -> None:
    seen = Seen()
    found = look(lowest_of(valley(2.013, -3e-3), valley(4.007, -1e-3)), [x / 50 for x in range(0, 400)], seen=seen)
    assert not found.found.any()
    _, k, g = seen.samples()
    lowest = int(g.argmin())
    assert 1e-3 <= float(g[lowest]) < 2e-3 and abs(float(k[lowest]) - 4.007) < 0.01


def test_a_shallow_way_down_that_touches_the_surface_before_it_goes_in() -> None:
    metric = lowest_of(lambda x: 0.02 * (5.003 - x[:, 0]), valley(4.9905, 1e-4, 0.1))
    found = look(metric, [x / 50 for x in range(0, 251)] + [5.01], (5.0, 5.01))
    assert abs(float(found.inner) - 4.9905) < 1e-3


def test_a_bottom_that_is_no_number_leaves_its_ray_undecided() -> None:
    def metric(x: Tensor) -> Tensor:
        g = valley(2.013, 1e-3)(x)
        return torch.where((x[:, 0] - 2.013).abs() < 5e-3, torch.nan, g)

    found = look(metric, [x / 50 for x in range(0, 400)])
    assert found.undecided.all() and not found.found.any()


def test_who_does_not_local_minima_samples_misses_a_short_chord_and_nothing_else() -> None:
    one, origin = torch.ones(2, dtype=torch.float64), torch.zeros(2, 3, dtype=torch.float64)
    origin[1, 1] = 1.0  # beside the post
    rays = Rays(torch.arange(2), origin, torch.eye(3).double()[[0, 0]], 0 * one, END * one)
    post = lambda x: valley(4.0071, 2e-4)(x) + 0.3 * x[:, 1].abs()  # noqa: E731
    field = ObjectField.of(lowest_of(post, valley(8.0, 0.3)), Frame(), torch.float64, 4096)
    first = [first_brackets(rays, field, STANDARD.with_(local_minima=look)).inner for look in (True, False)]
    assert abs(float(first[0][0]) - 4.0071) < 1e-3 and abs(float(first[1][0]) - 7.0) < 0.3
    assert first[0][1] == first[1][1]
