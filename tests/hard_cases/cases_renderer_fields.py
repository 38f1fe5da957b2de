"""Renderer: fields that are NaN, roots that resist, values that a dtype cannot distinguish."""

from __future__ import annotations

import math

import torch
from analytic_fields import Field, box, car, sphere
from catalogue import hard_case
from hard_scenes import (
    FAST,
    FEW,
    MANY,
    PLAIN,
    PRESETS,
    beams_along_x,
    draw,
    fan,
    hit_at,
    in_plain,
    pose,
    sound,
    unmoved,
)
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import SdfGrid, preset
from shift3d.render.field.object_field import ObjectField
from shift3d.sdf.bfloat16 import Bfloat16Field
from shift3d.sdf.decoder import load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles

SURFACE = sphere(1.0)
SOLVERS = {**PRESETS, "plain": FAST.with_(solver="plain_sphere_tracing")}


def _where(broken: Field, value: float) -> Field:
    """Return the field of a unit sphere that is `value` where `broken` is negative."""
    return lambda x: torch.where(broken(x) < 0, value, SURFACE(x))


def _lost(metric: Field, space: bool = False, names: tuple[str, ...] = tuple(SOLVERS)) -> None:
    """Check that beams at the middle of a shape are all counted as unresolved by every solver, and none is moved."""
    for name in names:
        for count in (FEW, MANY):
            beams = beams_along_x(count=count)
            known = SdfGrid.of(in_plain(metric), PLAIN, FAST) if space else None
            rendering = draw(beams, metric, settings=SOLVERS[name], frame=PLAIN, space=known)
            sound(rendering)
            unmoved(rendering, beams, unresolved=count)


@hard_case(
    area="renderer",
    why="a NaN is neither inside nor outside: every comparison with it is false, as for a miss",
    must="the beams that meet it are counted as unresolved and stay",
    guard="a march calls a ray undecided where g is not a number",
)
def a_field_of_nan() -> None:
    _lost(lambda x: x[:, 0] * math.nan)
    _lost(_where(SURFACE, math.nan))


@hard_case(
    area="renderer",
    why="an infinite value has a sign, and a root can be found beside it",
    must="the beams that meet it are counted as unresolved and stay",
    guard="a march asks for finite values, not for numbers",
)
def a_field_of_infinities() -> None:
    _lost(lambda x: torch.full_like(x[:, 0], math.inf))
    _lost(_where(SURFACE, -math.inf))


@hard_case(
    area="renderer",
    why="several samples of one beam are looked at ahead of time, and only the last of them could be written down",
    must="one beam alone is as unresolved as forty",
    guard="among the samples that count, one that is not finite is enough",
)
def nan_ahead_of_the_last_few_beams() -> None:
    _lost(_where(SURFACE, math.nan), names=("standard", "reference", "plain"))
    # A NaN behind the surface affects no beam.
    behind = _where(box((0.2, 1.0, 1.0), (0.3, 0.0, 0.0)), math.nan)
    for settings in SOLVERS.values():
        for count in (FEW, MANY):
            hit_at(draw(beams_along_x(count=count), behind, settings=settings, frame=PLAIN), 9.0)


@hard_case(
    area="renderer",
    why="a NaN between the two ends of a bracket keeps a search for the root away from it: it ends beside the gap",
    must="the beam is unresolved, not a hit with whatever residual",
    guard="a root that passed a value that is not finite is not found",
)
def nan_at_the_surface() -> None:
    _lost(lambda x: torch.where(SURFACE(x).abs() < 0.002, math.nan, SURFACE(x)))


@hard_case(
    area="renderer",
    why="the same, in the plain solvers",
    must="the beam is unresolved",
    guard="a row on which g is not finite counts as unresolved",
)
def nan_in_a_bracket_of_the_plain_solvers() -> None:
    _lost(lambda x: torch.where(SURFACE(x).abs() < 0.002, math.nan, SURFACE(x)), names=("plain", "paper"))


@hard_case(
    area="renderer",
    why="between the samples of a bracket that is crossed at a flat angle lies a NaN",
    must="the beam is unresolved",
    guard="a flat bracket with a value that is not finite before its crossing is no bracket",
)
def nan_in_a_flat_bracket() -> None:
    # g falls by 0.1 per metre: every bracket is flat. The NaN is in the middle of one, where no root search evaluates.
    for end in (0.8966, 1.1407, 1.6017):

        def ramp(x: Tensor, end: float = end) -> Tensor:
            g = 0.1 * (end - x[:, 0])
            return torch.where((g > 0.0002) & (g < 0.0030), math.nan, g)

        for count in (FEW, MANY):
            beams = beams_along_x(count=count)
            unmoved(draw(beams, ramp, frame=PLAIN), beams, unresolved=count)


@hard_case(
    area="renderer",
    why="a map of distances with NaN in it says neither that a place is free nor that it is not",
    must="the beams that meet it are marched and counted as unresolved",
    guard="what is not surely free is in doubt",
)
def nan_in_the_map() -> None:
    for metric in (lambda x: x[:, 0] * math.nan, _where(SURFACE, math.nan), _where(SURFACE, -math.inf)):
        _lost(metric, space=True, names=("standard",))


@hard_case(
    area="renderer",
    why="the map's error is measured, and a NaN among its places would make it NaN: then nothing is in doubt",
    must="every beam through the box is marched",
    guard="an error that is not a number is taken as infinite",
)
def nan_where_the_map_is_checked() -> None:
    # A NaN shell thinner than the lattice, on the surface: no lattice point shows it, checks between lattice points do.
    shell = lambda x: torch.where(SURFACE(x).abs() < 0.002, math.nan, SURFACE(x))  # noqa: E731
    space = SdfGrid.of(in_plain(shell), PLAIN, FAST)
    assert space.error_m == math.inf
    _lost(shell, space=True, names=("standard",))


@hard_case(
    area="renderer",
    why="the paper's march asks for the first negative sample, and a NaN before it is not negative",
    must="the beam is unresolved, in the plain renderer too",
    guard="a sample that is not finite, at the first inside or before, leaves a beam unresolved",
)
def nan_before_the_surface() -> None:
    gap = _where(box((0.2, 1.0, 1.0), (-1.8, 0.0, 0.0)), math.nan)
    _lost(gap, names=tuple(PRESETS))


@hard_case(
    area="renderer",
    why="a NaN where the box is checked cannot say whether the shape goes on outside",
    must="the beams that meet the field outside the baseline's box are looked at, and counted as unresolved",
    guard="a check point that is not above zero counts as inside, and the box grows",
)
def nan_where_the_box_is_checked() -> None:
    above = _where(box((3.0, 3.0, 0.5), (0.0, 0.0, 1.3)), math.nan)
    for name in ("standard", "plain"):
        beams = beams_along_x(z=1.3)
        unmoved(draw(beams, above, settings=SOLVERS[name], frame=PLAIN), beams, unresolved=1)


@hard_case(
    area="renderer",
    why="a field that is saturated, or grows a thousandfold within millimetres, gives chords that hardly shrink",
    must="the root, within the evaluations that are allowed",
    guard="a bracket that three steps have not halved is bisected",
)
def a_saturated_field() -> None:
    def of(change: Field) -> Field:
        return lambda x: change(SURFACE(x))

    fields = (
        of(lambda d: torch.tanh(1e4 * d)),
        of(lambda d: torch.where(d > 0, 1e-2, 1.0) * torch.tanh(1e5 * d)),
        of(lambda d: torch.expm1((2000.0 * d).clamp_max(30.0))),
    )
    for settings in PRESETS.values():
        for metric in fields:
            hit_at(draw(beams_along_x(0.3), metric, settings=settings, frame=PLAIN), 10.0 - math.sqrt(0.91), 1e-5)


@hard_case(
    area="renderer",
    why="a field that jumps from +1 to -1, flat on both sides, has no place with a small |g|",
    must="the hit is at the jump, and its residual says that |g| is a metre there",
    guard="a bracket that has shrunk to rounding counts as found, its residual is kept",
)
def a_field_that_jumps() -> None:
    for settings in PRESETS.values():
        rendering = draw(beams_along_x(), lambda x: torch.where(SURFACE(x) < 0, -1.0, 1.0), settings=settings)
        hit_at(rendering, 9.0)
        assert rendering.max_residual_m > 0.9


@hard_case(
    area="renderer",
    why="a root can take more evaluations than are allowed",
    must="the beam is counted as unresolved: hits and unresolved beams are those that hit with patience",
    guard="a bracket whose root was not reached is undecided",
)
def a_root_that_is_not_reached_in_time() -> None:
    theta = pose(12.0, 3.0, -1.0, 0.4)
    beams = fan(theta)
    patient = draw(beams, car(), theta)
    for limit in (1, 2):
        hasty = draw(beams, car(), theta, FAST.with_(max_iterations=limit, tolerance_m=1e-9))
        assert hasty.unresolved_beams > 0 and not (hasty.hit_mask & ~patient.hit_mask).any()
        assert hasty.object_points + hasty.unresolved_beams == patient.object_points
        assert torch.equal(hasty.points[~hasty.hit_mask], beams.points[~hasty.hit_mask])


@hard_case(
    area="renderer",
    why="in float32 |g| stalls at the rounding of the place it is evaluated at",
    must="what is promised is reached at 40 m too, and a tolerance below that rounding is refused",
    guard="a tolerance is compared with what the dtype can reach on this object",
)
def a_tolerance_below_the_rounding() -> None:
    theta = pose(40.0, 8.0, -1.0, 0.4)
    beams = fan(theta, half_angle_rad=0.06, far_m=80.0)
    single, double = draw(beams, car(), theta, preset("standard")), draw(beams, car(), theta, PRESETS["reference"])
    assert single.max_residual_m <= preset("standard").tolerance_m
    both = single.hit_mask & double.hit_mask
    assert both.sum() > 50 and float((single.range_m - double.range_m)[both].abs().quantile(0.95)) < 1e-4
    finest = preset("standard").with_(tolerance_m=1e-7)
    try:
        draw(beams, car(), theta, finest)
    except InputError as error:
        assert "float32" in str(error)
    else:
        raise AssertionError("1e-7 m was promised in float32 at 2.5 m a unit")


@hard_case(
    area="renderer",
    why="far values are taken from bfloat16, off by up to 7 mm, and next to the surface that is a sign",
    must="no value below the band is a coarse one, no sign either",
    guard="values below the band are evaluated again",
)
def a_coarse_value_next_to_the_surface() -> None:
    vehicle = baseline_vehicles()["coupe"]
    sdf = load_decoder().field(torch.from_numpy(vehicle.latent_code))
    fine = ObjectField.of(sdf, vehicle, torch.float32, 4096)
    with torch.no_grad():
        along = torch.linspace(-2.4, 2.4, 240, dtype=torch.float64)
        x = torch.stack((along, torch.full_like(along, 0.3), torch.full_like(along, -0.1)), 1)
        coarse = ObjectField.of(sdf, vehicle, torch.float32, 4096, bfloat16_band_m=0.02)
        # Also on a processor that is slow in bfloat16.
        vars(sdf)["rough"] = Bfloat16Field(sdf.weights, sdf.biases, sdf.skip_layer)
        estimate, exact = coarse.estimate(x), fine(x)
        assert coarse.count.coarse > 0, "some are coarse"
    near = (exact < 0.01) | (estimate < 0.01)
    assert near.sum() > 20 and torch.equal(estimate < 0, exact < 0)
    assert float((estimate - exact)[near].abs().max()) < 1e-5
