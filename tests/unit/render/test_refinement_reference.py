"""Refinement against plain reference: dense samples every millimetre, and one ray refined interval by interval."""

import itertools
import math
from collections.abc import Callable

import torch
from analytic_fields import Field, box, sphere, union
from hypothesis import given, settings
from hypothesis import strategies as st
from straight_rays import (
    FLOAT64,
    along_x,
    check_against_dense,
    chords,
    cold,
    crossings,
    field_of,
    is_found,
    samples_at,
)

from shift3d.render.culling import Rays
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.refinement import Refinement, refine

NO_MINIMA = FLOAT64.with_(local_minima=False)
RAYS = along_x(*(0.17 * n for n in range(-4, 5)))
PLACE = st.tuples(st.floats(-2.0, 2.0), st.floats(-0.9, 0.9), st.floats(-0.3, 0.3))
BALL = st.builds(lambda at, radius: sphere(radius, at), PLACE, st.floats(0.05, 0.6))
BLOCK = st.builds(
    lambda at, half: box(half, at), PLACE, st.tuples(st.floats(0.03, 0.5), st.floats(0.05, 0.5), st.floats(0.05, 0.8))
)
SHAPE = st.lists(st.one_of(BALL, BLOCK), min_size=1, max_size=4).map(lambda parts: union(*parts))


def _from(samples: RaySamples, shape: Field, hit_m: torch.Tensor, chosen: RenderSettings = FLOAT64) -> Refinement:
    found = refine(samples, RAYS, hit_m, field_of(shape), chosen)
    assert not found.undecided.any() and not found.open.any()
    return found


def _predicted(shape: Field, rays: Rays, spacing_m: float, error_m: float, seed: int) -> RaySamples:
    """Return samples with errors up to a stated bound, outside and inside the object."""
    exact = samples_at(rays, shape, torch.arange(0.0, 6.0 + spacing_m, spacing_m).clamp_max(6.0))
    share = torch.rand(len(exact), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    off = (2.0 * share - 1.0) * error_m
    return RaySamples.none().joined(RaySamples(exact.rows, exact.k, exact.g + off, torch.full_like(off, error_m)))


def _hardly_outside(shape: Field, rays: Rays, spacing_m: float, error_m: float) -> torch.Tensor:
    """Count (M,) places in front of the object, `spacing_m` apart, that a prediction may take for inside."""
    exact = samples_at(rays, shape, torch.arange(0.0, 6.0 + spacing_m, spacing_m).clamp_max(6.0))
    g = exact.g.reshape(len(rays), -1)
    return ((g < error_m) & ((g < 0).cumsum(1) == 0)).sum(1)


NOWHERE = torch.full_like(RAYS.far_m, math.nan)


@settings(max_examples=30, deadline=None)
@given(shape=SHAPE, minima=st.booleans())
def test_every_chord_of_five_centimetres_is_found_where_nothing_is_known(shape: Field, minima: bool) -> None:
    chosen = FLOAT64.with_(local_minima=minima)
    found = _from(RaySamples.none(), shape, NOWHERE, chosen)
    check_against_dense(crossings(found, shape, RAYS), shape, RAYS)
    check_against_dense(crossings(cold(RAYS, shape, chosen), shape, RAYS), shape, RAYS)


@settings(max_examples=30, deadline=None)
@given(
    shape=SHAPE,
    spacing=st.sampled_from([0.02, 0.1, 0.3]),
    error=st.sampled_from([1e-6, 0.005, 0.03, 0.2]),
    seed=st.integers(0, 99),
)
def test_and_where_samples_are_predicted_with_bounds_that_hold(
    shape: Field, spacing: float, error: float, seed: int
) -> None:
    found = refine(_predicted(shape, RAYS, spacing, error, seed), RAYS, NOWHERE, field_of(shape), FLOAT64)
    # Predicted inside places are evaluated one after the other. Only a ray with many wrong ones, as along a face, is
    # left to a search.
    assert (_hardly_outside(shape, RAYS, spacing, error)[found.open] >= 8).all()
    check_against_dense(crossings(found, shape, RAYS), shape, RAYS, skipped=found.open)


@settings(max_examples=30, deadline=None)
@given(shape=SHAPE, error=st.sampled_from([0.005, 0.03]), seed=st.integers(0, 99))
def test_what_lies_well_in_front_of_a_known_hit_is_found(shape: Field, error: float, seed: int) -> None:
    """The given hit is the last entry into the object. A plain approach within `approach_m` of it is not sampled."""
    stretches = chords(shape, RAYS)
    last = torch.tensor([each[-1][0] if each else math.nan for each in stretches], dtype=torch.float64)
    found = _from(_predicted(shape, RAYS, 0.1, error, seed), shape, last)
    entry = crossings(found, shape, RAYS)
    for row, each in enumerate(stretches):
        well = [a for a, b in each[:-1] if b - a >= 0.05 and b < float(last[row]) - FLOAT64.approach_m]
        if well:
            assert float(entry[row]) <= well[0] + 2e-3
        if len(each) == 1:
            assert not float(entry[row]) < each[0][0] - 2e-3


def _gap(k_a: float, g_a: float, k_b: float, g_b: float, chosen: RenderSettings) -> float:
    """Return the part of an interval outside the spheres of its ends. L is at least the slope that they show."""
    width = k_b - k_a
    steep = min(max(abs(g_a - g_b) / width, 1.0), 10.0)
    return width - chosen.step_safety * (_counts(g_a, chosen) + _counts(abs(g_b), chosen)) / steep


def _counts(g: float, chosen: RenderSettings) -> float:
    return min(max(g, 0.0), chosen.max_step_m)


def _refined(
    g: Callable[[float], float], k_a: float, k_b: float, is_end: bool, chosen: RenderSettings
) -> list[tuple[float, float]]:
    """Return samples after k_a up to k_b or the first one inside. is_end: k_b is the ray's end, already sampled."""
    g_a, g_b = g(k_a), g(k_b)
    if _gap(k_a, g_a, k_b, g_b, chosen) > (0.0 if is_end and g_b >= 0 else chosen.step_m):
        steep = min(max(abs(g_a - g_b) / (k_b - k_a), 1.0), 10.0) / chosen.step_safety
        share = 0.5 + 0.5 * (_counts(g_a, chosen) - _counts(abs(g_b), chosen)) / (steep * (k_b - k_a))
        middle = k_a + min(max(share, 0.05), 0.95) * (k_b - k_a)
        front = _refined(g, k_a, middle, False, chosen)
        return front if front[-1][1] < 0 else front + _refined(g, middle, k_b, is_end, chosen)
    return [(k_b, g_b)]


@settings(max_examples=30, deadline=None)
@given(shape=SHAPE)
def test_all_rays_at_once_are_refined_as_each_alone_interval_by_interval(shape: Field) -> None:
    chosen = NO_MINIMA.with_(grazing_m=10.0)
    found = _from(RaySamples.none(), shape, NOWHERE, chosen)
    for row in range(len(RAYS)):

        def g(k: float, row: int = row) -> float:
            return float(shape(RAYS.at(torch.tensor([k], dtype=torch.float64), torch.tensor([row]))))

        # The ray's end is sampled first; then the interval in front of the end is tested for coverage.
        samples = [(0.0, g(0.0)), *_refined(g, 0.0, 6.0, False, chosen)]
        inside = samples[-1][1] < 0
        mine = found.samples.select(found.samples.rows == row)
        outside = samples[:-1] if inside else samples
        expected = torch.tensor([k for k, _ in outside], dtype=torch.float64)
        assert len(mine) == len(expected) and torch.allclose(mine.k, expected, rtol=0, atol=1e-9)
        at = torch.nonzero(found.brackets.rows == row).squeeze(1)
        assert len(at) == int(inside)
        if inside:
            assert abs(float(found.brackets.inner[at]) - samples[-1][0]) < 1e-9


@settings(max_examples=30, deadline=None)
@given(shape=SHAPE, predicted=st.booleans(), minima=st.booleans(), seed=st.integers(0, 99))
def test_what_stays_uncovered_is_shorter_than_the_least_step(
    shape: Field, predicted: bool, minima: bool, seed: int
) -> None:
    """Between all neighbouring samples: width <= step_safety (g_a + g_b) + step_m, each g less its error bound."""
    chosen = FLOAT64.with_(local_minima=minima)
    before = _predicted(shape, RAYS, 0.1, 0.02, seed) if predicted else RaySamples.none()
    found = _from(before, shape, NOWHERE, chosen)
    entered = is_found(found)
    for row in range(len(RAYS)):
        mine = found.samples.select(found.samples.rows == row)
        places = list(zip(mine.k.tolist(), (mine.g - mine.error).tolist(), strict=True))
        assert places[0][0] <= chosen.step_safety * max(places[0][1], 0.0) + chosen.step_m
        if entered[row]:
            at = torch.nonzero(found.brackets.rows == row).squeeze(1)
            places.append((float(found.brackets.inner[at]), -float(found.brackets.g_inner[at])))
        else:
            assert 6.0 - places[-1][0] <= chosen.step_safety * max(places[-1][1], 0.0) + 1e-9
        for (k_a, g_a), (k_b, g_b) in itertools.pairwise(places):
            assert k_b - k_a <= chosen.step_safety * (max(g_a, 0.0) + max(g_b, 0.0)) + chosen.step_m + 1e-9
