"""Local minima between the samples of a ray are searched near the surface, and classified correctly."""

import math

import torch
from analytic_fields import Field
from straight_rays import FLOAT64, along_x, field_of, is_found, samples_at
from torch import Tensor

from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.refinement import Refinement, refine

RAY = along_x(0.0, start=0.0, length=10.0)


def look(metric: Field, last: float = 8.0, hit_m: float = math.nan, settings: RenderSettings = FLOAT64) -> Refinement:
    """Refine one ray along x that was sampled every 2 cm up to a range."""
    samples = samples_at(RAY, metric, [x / 50 for x in range(round(50 * last))])
    return refine(samples, RAY, torch.full((1,), hit_m, dtype=torch.float64), field_of(metric), settings)


def valley(at: float, depth: float, slope: float = 0.3) -> Field:
    """Return |x - at| slope - depth: below zero on a chord of 2 depth / slope."""
    return lambda x: slope * (x[:, 0] - at).abs() - depth


def lowest_of(*fields: Field) -> Field:
    def g(x: Tensor) -> Tensor:
        return torch.stack([field(x) for field in fields]).amin(0)

    return g


def test_the_first_of_several_dips_that_cross_is_the_crossing() -> None:
    metric = lowest_of(valley(2.013, -1e-4), valley(4.007, 2e-4), valley(6.0051, 3e-4))
    found = look(metric)
    b = found.brackets
    assert is_found(found).all() and not found.undecided.any()
    assert 3.99 < float(b.outer) < 4.007 - 2e-4 / 0.3 < float(b.inner) < 4.007 + 2e-4 / 0.3
    assert float(b.g_outer) > 0 > float(b.g_inner)


def test_a_dip_in_front_of_a_hit_comes_first_and_one_behind_it_is_nothing() -> None:
    wall = valley(7.0, 0.3)
    in_front = look(lowest_of(valley(3.007, 2e-4), wall), 6.0, hit_m=6.0)
    assert abs(float(in_front.brackets.inner) - 3.007) < 1e-3
    assert not is_found(look(lowest_of(valley(9.007, 2e-4), wall), 9.2, hit_m=6.0)).any()


def test_dips_that_do_not_reach_the_surface_are_no_hits_and_their_bottoms_are_sampled() -> None:
    found = look(lowest_of(valley(2.013, -3e-3), valley(4.007, -1e-3)))
    assert not is_found(found).any()
    lowest = int(found.samples.g.argmin())
    assert 1e-3 <= float(found.samples.g[lowest]) < 2e-3 and abs(float(found.samples.k[lowest]) - 4.007) < 0.01


def test_a_shallow_way_down_that_touches_the_surface_before_it_goes_in() -> None:
    metric = lowest_of(lambda x: 0.02 * (5.003 - x[:, 0]), valley(4.9905, 1e-4, 0.1))
    found = look(metric, 5.04)
    assert abs(float(found.brackets.inner) - 4.9905) < 1.5e-3


def test_a_bottom_that_is_no_number_leaves_its_ray_undecided() -> None:
    def metric(x: Tensor) -> Tensor:
        g = valley(2.013, 1e-3)(x)
        return torch.where((x[:, 0] - 2.013).abs() < 5e-3, torch.nan, g)

    found = look(metric)
    assert found.undecided.all() and not is_found(found).any()


def test_who_does_not_look_at_local_minima_misses_a_short_chord_and_nothing_else() -> None:
    metric = lowest_of(valley(4.0071, 2e-4), valley(8.0, 0.3))
    found = {minima: look(metric, 7.5, settings=FLOAT64.with_(local_minima=minima)) for minima in (True, False)}
    assert abs(float(found[True].brackets.inner) - 4.0071) < 1e-3
    assert float(found[False].brackets.outer) <= 7.0 < float(found[False].brackets.inner)
