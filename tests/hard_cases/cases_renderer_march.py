"""Renderer: surfaces between two samples of a march: thin, flat and steep."""

from __future__ import annotations

import math

import numpy as np
import torch
from analytic_fields import Field, box, sphere, union
from catalogue import hard_case
from hard_scenes import FAST, FEW, MANY, PLAIN, PRESETS, at_most, beams_along_x, draw, hit_at, unmoved
from torch import Tensor

from shift3d.render import Beams

PLACES = np.linspace(-0.5, 0.5, 9).tolist()


@hard_case(
    area="renderer",
    why="a beam in a face of the object, or tangent to a sphere, meets g = 0 without a change of sign",
    must="a miss that is resolved: g exactly 0 counts as outside, at the return too",
    guard="only g < 0 is inside",
)
def a_beam_that_touches_the_surface() -> None:
    for settings in PRESETS.values():
        beams = beams_along_x(1.0)
        unmoved(draw(beams, box((1.0, 1.0, 1.0)), settings=settings, frame=PLAIN), beams)
        unmoved(draw(beams, sphere(1.0), settings=settings, frame=PLAIN), beams)
        for count in (FEW, MANY):
            ends_on_it = beams_along_x(end_x=9.0, count=count)
            unmoved(draw(ends_on_it, box((1.0, 1.0, 1.0)), settings=settings, frame=PLAIN), ends_on_it)


@hard_case(
    area="renderer",
    why="along a panel g stays what it is: three samples lie on a line, their parabola has no bottom",
    must="a miss that is resolved, for a field positive everywhere too, and none of its places is no number",
    guard="where a parabola has no bottom between the samples the middle of the longer side is looked at",
)
def a_beam_that_keeps_its_distance_from_a_panel() -> None:
    def positive(x: Tensor) -> Tensor:
        assert torch.isfinite(x).all()
        return torch.full_like(x[:, 0], 0.001)

    for name, settings in PRESETS.items():
        beams = beams_along_x(0.751, count=MANY if name == "standard" else FEW)
        unmoved(draw(beams, box((0.5, 0.75, 0.7)), settings=settings, frame=PLAIN), beams)
        unmoved(draw(beams, positive, settings=settings, frame=PLAIN), beams)


@hard_case(
    area="renderer",
    why="a decoder is piecewise linear: a minimum of a millimetre has a kink, which no parabola points to",
    must="a chord of a millimetre is hit where the beam goes in",
    guard="a local minimum is refined as long as the surface may lie between its samples",
)
def a_chord_of_a_millimetre_between_kinks() -> None:
    hits = 0
    for at in np.linspace(-0.2, 0.2, 25, endpoint=False).tolist():
        metric = lambda x, at=at: 0.3 * (x[:, 0] - at).abs() - 1.5e-4  # noqa: E731
        found = draw(beams_along_x(count=MANY), metric, frame=PLAIN)
        hits += bool(found.hit_mask[0]) and abs(float(found.range_m[0]) - (10.0 + at - 5e-4)) < 1e-4
    assert hits >= 24, hits


@hard_case(
    area="renderer",
    why="a chord at the limb of a sphere is shorter than the steps of a march, down to half a millimetre",
    must="it is hit, where the beam goes in",
    guard="local minima are refined to their bottom",
)
def chords_shorter_than_a_step() -> None:
    beams, entry = _limb()
    found = draw(beams, sphere(1.0), frame=PLAIN)
    assert found.hit_mask.double().mean() >= 0.95
    assert float((found.range_m - entry)[found.hit_mask].abs().max()) <= FAST.grazing_m


@hard_case(
    area="renderer",
    why="a march that found a short chord in a local minimum has already stepped past it, towards the wall behind",
    must="the chord is the first hit, not the wall",
    guard="local minima are searched on rays with a crossing too",
)
def a_short_chord_in_front_of_a_wall() -> None:
    beams, entry = _limb()
    found = draw(beams, union(sphere(1.0), box((0.2, 2.0, 0.5), (2.0, 0.0, 0.0))), frame=PLAIN)
    assert found.hit_mask.all()
    assert float(((found.range_m - entry).abs() <= FAST.grazing_m).double().mean()) >= 0.95


@hard_case(
    area="renderer",
    why="the bottom of a local minimum can lie before its middle sample, which then is already behind a post",
    must="a post that is hit is hit where the beam goes in, never where it comes out",
    guard="the outer end of the bracket is the last sample before the bottom",
)
def the_way_into_a_thin_post() -> None:
    hits = 0
    for at in np.linspace(-1.0, -0.75, 25, endpoint=False).tolist():
        found = draw(beams_along_x(count=MANY), _post(at, 0.008), frame=PLAIN)
        assert not found.hit_mask.any() or abs(float(found.range_m[0]) - (10.0 + at - 0.008)) < 1e-4
        hits += bool(found.hit_mask[0])
    assert hits >= 20, hits


@hard_case(
    area="renderer",
    why="along a panel a march takes long steps, and a plate stands across its way",
    must="the plate is hit where it stands",
    guard="a step longer than g vouches for counts only where both its ends cover it",
)
def a_plate_across_a_beam_along_a_panel() -> None:
    for at in PLACES:
        metric = union(box((2.0, 0.3, 0.7), (0.0, -0.4, 0.0)), box((0.01, 0.3, 0.5), (at, 0.0, 0.0)))
        hit_at(draw(beams_along_x(count=MANY), metric, frame=PLAIN), 10.0 + at - 0.01)


@hard_case(
    area="renderer",
    why="the last rays of a march are sampled ahead as if g stayed what it is, and a plate lies between two samples",
    must="few rays hit what many hit",
    guard="samples ahead count as far as the spheres around them cover the beam, and minima between them are refined",
)
def a_plate_before_the_last_few_beams() -> None:
    for at in PLACES:
        for count in (FEW, 7, MANY):
            hit_at(draw(beams_along_x(count=count), _plate(at), frame=PLAIN), 10.0 + at - 0.01)


@hard_case(
    area="renderer",
    why="samples ahead are spread by the field at the first, and the field turns out steeper than a distance",
    must="few rays hit what many hit, in a field twice and five times as steep too",
    guard="samples vouch for as much as the steepest step so far allows",
)
def a_steep_field_before_the_last_few_beams() -> None:
    for at in PLACES:
        for times in (2.0, 5.0):
            steep = lambda x, at=at, times=times: times * _plate(at)(x)  # noqa: E731
            hit_at(draw(beams_along_x(), steep, frame=PLAIN), 10.0 + at - 0.01)


@hard_case(
    area="renderer",
    why="samples ahead that turn out uncovered are taken again, and the first of them would be so for ever",
    must="the march ends",
    guard="where the first is uncovered the next is as much shorter as the field is steeper",
)
def a_first_step_that_is_not_covered() -> None:
    # Flat up to the last sample, then a cliff: the first sample ahead is steeper than all before.
    def cliff(x: Tensor) -> Tensor:
        return torch.minimum(torch.full_like(x[:, 0], 0.3), 6.0 * (1.0 - x[:, 0])).clamp_max(0.3)

    for settings in PRESETS.values():
        hit_at(draw(beams_along_x(), at_most(cliff, 800), settings=settings, frame=PLAIN), 11.0)


@hard_case(
    area="renderer",
    why="a sample taken ahead lands inside a wall, behind a plate that it stepped over: three roots in one bracket",
    must="the plate is the first hit",
    guard="a step that is not covered is taken again, shorter, wherever it led",
)
def three_roots_in_one_bracket() -> None:
    for at in np.linspace(-0.5, 0.5, 17).tolist():
        plates = union(box((0.015, 0.5, 0.5), (at, 0.0, 0.0)), box((0.3, 0.5, 0.5), (at + 0.345, 0.0, 0.0)))
        for count in (FEW, MANY):
            hit_at(draw(beams_along_x(count=count), plates, frame=PLAIN), 10.0 + at - 0.015)


@hard_case(
    area="renderer",
    why="a beam that skims a panel enters it by a quarter of a millimetre and again a centimetre on",
    must="the first crossing is the hit, not the second",
    guard="a bracket that is crossed at a flat angle is sampled every 3 mm",
)
def a_beam_that_skims_a_rippled_panel() -> None:
    height, first_m, width_m = 0.0002036, 0.000488, 0.00191

    def panel(x: Tensor) -> Tensor:
        first = first_m * torch.exp(-((x[:, 0] / width_m) ** 2))
        second = 0.001227 * torch.exp(-(((x[:, 0] - 0.01155) / 0.005987) ** 2))
        return torch.maximum(x[:, 1] - first - second, x[:, 0].abs() - 1.0)

    starts = np.linspace(0.0, 0.2, 60)
    origins = np.stack([starts, np.full(60, height), np.zeros(60)], 1)
    found = draw(Beams.from_arrays(np.array([[30.0, height, 0.0]] * 60), origins), panel, frame=PLAIN)
    entry = 10.0 - width_m * math.sqrt(math.log(first_m / height)) - torch.from_numpy(starts)
    assert found.hit_mask.all()
    assert float((found.range_m - entry).abs().max()) < 2e-4


@hard_case(
    area="renderer",
    why="a field five times as steep as a distance says that the surface is five times as far as it is",
    must="a thin plate in it is hit",
    guard="a step is divided by how much faster than a distance g has fallen",
)
def a_field_steeper_than_a_distance() -> None:
    for at in PLACES:
        steep = lambda x, at=at: 5.0 * _plate(at)(x)  # noqa: E731
        hit_at(draw(beams_along_x(count=MANY), steep, frame=PLAIN), 10.0 + at - 0.01)


def _limb() -> tuple[Beams, Tensor]:
    """Return beams in +x with chords of 0.5 to 20 mm through a unit sphere at x = 10, and their entry ranges."""
    chord = np.linspace(0.0005, 0.02, 200)
    y = np.sqrt(1.0 - (chord / 2) ** 2)
    zero = np.zeros(200)
    beams = Beams.from_arrays(np.stack([np.full(200, 30.0), y, zero], 1), np.stack([zero, y, zero], 1))
    return beams, torch.from_numpy(10.0 - chord / 2)


def _plate(x: float) -> Field:
    """Return a plate 2 cm thick, perpendicular to the beam."""
    return box((0.01, 0.5, 0.5), (x, 0.0, 0.0))


def _post(x: float, radius_m: float) -> Field:
    """Return an upright post in the beam's path."""
    return lambda p: torch.hypot(p[:, 0] - x, p[:, 1]) - radius_m
