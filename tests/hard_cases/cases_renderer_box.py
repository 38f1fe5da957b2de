"""Renderer: sensors, returns and surfaces where the object's box does not expect them, shapes outside the box."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_fields import box, car, ground_scan, sphere, union
from catalogue import hard_case
from hard_scenes import (
    AT_TEN,
    FAST,
    FEW,
    MANY,
    PAPER,
    PLAIN,
    PRESETS,
    BentLine,
    beams_along_x,
    draw,
    hit_at,
    in_plain,
    pose,
    sound,
    unmoved,
)
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import Beams, Rendering, SdfGrid, render


@hard_case(
    area="renderer",
    why="a beam in a face of the box divides zero by zero, one parallel to a face divides by zero",
    must="a beam in the face is inside the box: what stands out there is hit",
    guard="a component below 1e-12 is never divided by",
)
def beams_parallel_to_the_faces_of_the_box() -> None:
    # The checked box ends at y = 0.9375 exactly; a fin reaches past it between two check points.
    frame = replace(PLAIN, size_m=(4.4, 1.75, 1.5))
    fin = union(box((2.0, 0.85, 0.7)), box((0.04, 1.0, 0.04), (0.098, 0.0, 0.0)))
    margin = FAST.with_(box_margin_m=0.0625)
    hit_at(draw(beams_along_x(0.9375), fin, settings=margin, frame=frame), 10.058)
    for settings in PRESETS.values():
        for y in (0.0, 0.84, -0.84):
            rendering = draw(beams_along_x(y), fin, settings=settings)
            sound(rendering)
            hit_at(rendering, 8.0)


@hard_case(
    area="renderer",
    why="a box around the sensor begins behind it, and so may the object's surface",
    must="only what lies ahead of the sensor is hit",
    guard="the stretch of a beam in the box never begins before the sensor",
)
def a_sensor_inside_the_box_with_a_surface_behind_it() -> None:
    behind = union(box((0.2, 0.5, 0.5), (-1.8, 0.0, 0.0)), box((0.2, 0.5, 0.5), (1.8, 0.0, 0.0)))
    for settings in PRESETS.values():
        for count in (FEW, MANY):
            hit_at(draw(beams_along_x(start_x=9.0, count=count), behind, settings=settings), 2.6)


@hard_case(
    area="renderer",
    why="the object stands behind what the scan saw: a wall, a truck, the first of two returns",
    must="nothing moves and nothing fails",
    guard="the stretch of a beam in the box ends at its return",
)
def an_object_behind_the_returns() -> None:
    points, origin = ground_scan(rings=32, columns=360)
    behind = (np.hypot(points[:, 0], points[:, 1]) > 9.6) & (np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.4)
    points[behind] *= (9.6 / np.hypot(points[behind, 0], points[behind, 1]))[:, None]
    beams = Beams.from_arrays(points, origin)
    for settings in (PRESETS["standard"], PRESETS["reference"], PAPER.with_(sphere_chord_only=True)):
        unmoved(draw(beams, car(), pose(12.0, 0.0, -0.98), settings), beams)


@hard_case(
    area="renderer",
    why="the last step of a march reaches beyond the return, and the surface lies there",
    must="a return before the surface stays, to a tenth of a millimetre; one behind it moves onto it",
    guard="the last sample of a march is at the return itself",
)
def a_surface_at_the_end_of_a_beam() -> None:
    wall = box((1.0, 1.0, 1.0))
    for settings in PRESETS.values():
        for count in (FEW, MANY):
            short = beams_along_x(end_x=8.9999, count=count)
            unmoved(draw(short, wall, settings=settings), short)
            hit_at(draw(beams_along_x(end_x=9.0001, count=count), wall, settings=settings), 9.0)


@hard_case(
    area="renderer",
    why="a beam that starts inside the object has no crossing from outside",
    must="it is counted as unresolved and its return stays",
    guard="the paper's march calls a beam whose first sample is inside unresolved",
)
def a_sensor_inside_the_object() -> None:
    for settings in PRESETS.values():
        for count in (FEW, MANY):
            beams = beams_along_x(start_x=10.0, count=count)
            unmoved(draw(beams, sphere(1.0), settings=settings), beams, unresolved=count)


@hard_case(
    area="renderer",
    why="a sensor touches the surface: its distance is below the tolerance of a root, and a root there has range zero",
    must="outside and on the surface each beam hits, inside each is unresolved: with every solver, warm, and on a grid",
    guard="the sign of the field at the sensor decides, never the size of the distance",
)
def a_sensor_at_the_surface() -> None:
    wall = box((1.0, 0.8, 0.7))
    grid = SdfGrid.of(in_plain(wall), PLAIN, FAST)
    for gap in (1e-6, 1e-7, 1e-9, 0.0, -1e-9, -1e-7, -1e-6):
        for count in (FEW, MANY):
            beams = beams_along_x(start_x=9.0 - gap, count=count)
            before = draw(beams, wall, pose(10.0 + 1e-4).requires_grad_(), frame=PLAIN)
            drawn = [draw(beams, wall, settings=settings, frame=PLAIN) for settings in PRESETS.values()]
            drawn.append(draw(beams, wall, frame=PLAIN, space=grid))
            drawn.append(draw(beams, wall, AT_TEN.clone().requires_grad_(), warm=before.warm, frame=PLAIN))
            line = BentLine(8.0, [(-8.0, -1.0)])  # the half-space beyond x = 10
            surface = beams_along_x(start_x=10.0 - gap, count=count)
            for rendering in [*drawn, draw_network(surface, line)]:
                if gap < 0:
                    assert not rendering.hit_mask.any() and rendering.unresolved_beams == count
                else:
                    hit_at(rendering, gap, 1.1 * FAST.tolerance_m)


def draw_network(beams: Beams, line: BentLine) -> Rendering:
    """Return the reference rendering of a network whose origin is at x = 10: the traversal of its linear regions."""
    with torch.no_grad():
        return render(beams, line, AT_TEN, PLAIN, PRESETS["reference"])


@hard_case(
    area="renderer",
    why="a code far off the prior can be inside everywhere: no beam has a way in",
    must="every beam through the decoder's ball is counted as unresolved, nothing moves",
    guard="a march that is still inside when it is back at its sensor calls the beam undecided",
)
def a_field_negative_everywhere() -> None:
    for settings in PRESETS.values():
        for count in (FEW, MANY):
            beams = beams_along_x(count=count)
            unmoved(draw(beams, lambda x: torch.full_like(x[:, 0], -0.3), settings=settings), beams, unresolved=count)


@hard_case(
    area="renderer",
    why="a thin part can leave the checked box between two of the places where it is checked",
    must="a beam that enters the box inside that part hits the part where it begins",
    guard="a march that starts inside goes back towards the sensor until it is outside",
)
def a_part_that_sticks_out_of_the_checked_box() -> None:
    for settings in PRESETS.values():
        for count in (FEW, MANY):
            hit_at(draw(beams_along_x(count=count), _NOSE, settings=settings), 10.0 - 2.6)


@hard_case(
    area="renderer",
    why="going back from the box, a march that passes the sensor would find the way in behind it",
    must="the sensor is inside that part: the beam is unresolved, its range never negative",
    guard="going back ends at the sensor",
)
def a_sensor_inside_a_part_outside_the_box() -> None:
    for settings in PRESETS.values():
        for start_x in (7.45, 7.55):
            beams = beams_along_x(start_x=start_x)
            unmoved(draw(beams, _NOSE, settings=settings), beams, unresolved=1)


@hard_case(
    area="renderer",
    why="a code far off the prior breaks into pieces, and one may float outside the baseline's box",
    must="every piece is hit",
    guard="the box is also checked on a lattice in the rest of the decoder's ball",
)
def a_shape_in_pieces() -> None:
    pieces = union(sphere(0.3, (-1.5, 0.0, 0.0)), sphere(0.3, (1.5, 0.9, 0.6)), sphere(0.4, (0.0, 0.0, 1.8)))
    for settings in PRESETS.values():
        hit_at(draw(beams_along_x(), pieces, settings=settings), 8.2)
        hit_at(draw(beams_along_x(0.9, z=0.6), pieces, settings=settings), 11.2)
        hit_at(draw(beams_along_x(z=1.8), pieces, settings=settings), 9.6)


@hard_case(
    area="renderer",
    why="a shape under attack outgrows the box of its baseline, in which its beams were looked for",
    must="what stands out is hit as the rest is",
    guard="the box grows until the field is outside on all of its faces",
)
def a_shape_that_outgrew_its_box() -> None:
    grown = union(car(), box((0.3, 0.3, 0.3), (0.0, 0.0, 1.0)))
    for settings in PRESETS.values():
        hit_at(draw(beams_along_x(z=1.15), grown, settings=settings), 9.7)


@hard_case(
    area="renderer",
    why="some beams hit, some pass, some start inside and some meet a NaN in front of the surface, all in one scene",
    must="each is a hit, a miss or unresolved, as geometry has it, and the three add up to all beams",
    guard="a ray that is undecided is not found, whatever it met afterwards",
)
def every_beam_is_a_hit_a_miss_or_unresolved() -> None:
    def metric(x: Tensor) -> Tensor:
        gap = (x[:, 1] > 0.3) & (x[:, 0] > -1.9) & (x[:, 0] < -1.3)
        return torch.where(gap, math.nan, sphere(1.0)(x))

    y = np.tile(np.linspace(-1.45, 1.45, 30), 2)
    start = np.repeat([0.0, 10.0], 30)
    zero = np.zeros(60)
    beams = Beams.from_arrays(np.stack([zero + 30.0, y, zero], 1), np.stack([start, y, zero], 1))
    inside = (start == 10.0) & (np.abs(y) < 1.0)
    lost = inside | ((start == 0.0) & (y > 0.3))
    hit = (start == 0.0) & (y > -1.0) & ~lost
    for settings in PRESETS.values():
        rendering = draw(beams, metric, settings=settings.with_(box_margin_m=0.65), frame=PLAIN)
        sound(rendering)
        assert rendering.hit_mask.tolist() == hit.tolist()
        assert rendering.unresolved_beams == int(lost.sum())
        assert torch.equal(rendering.points[~rendering.hit_mask], beams.points[~rendering.hit_mask])


@hard_case(
    area="renderer",
    why="a part with a radius of 12 cm floats beside the box, between check points that are 45 cm apart",
    must="it is hit",
    guard="cells outside the box that the field does not show to be free are divided",
)
def a_small_part_that_floats_beside_the_box() -> None:
    for y, z in ((1.35, 0.05), (1.2, 0.3), (-1.3, 0.45), (0.1, 1.3)):
        both = union(box((2.0, 0.8, 0.7)), sphere(0.12, (0.1, y, z)))
        found = draw(beams_along_x(y=y, z=z), both, frame=PLAIN)
        hit_at(found, 9.98)


# A nose 6 cm wide that leaves the checked box (x = -2.25 and on) between two of its check points.
_NOSE = union(box((2.0, 0.8, 0.7)), box((0.6, 0.03, 0.03), (-2.0, 0.0, 0.0)))


@hard_case(
    area="renderer",
    why="a vehicle of 20 m reaches out of the paper's sphere of 7 m: beams that meet it there would stay as they were",
    must="the paper's renderer refuses it; the others hit its end",
    guard="half the diagonal of the vehicle's box is compared with the sphere",
)
def a_vehicle_longer_than_the_papers_sphere() -> None:
    frame, long = replace(PLAIN, size_m=(20.0, 2.0, 1.5)), box((10.0, 1.0, 0.75))
    beside = beams_along_x()
    for settings in PRESETS.values():
        if settings.solver == "paper":
            with pytest.raises(InputError, match=r"20\.0 x 2\.0 x 1\.5 m reaches out of the paper's sphere of 7 m"):
                draw(beside, long, pose(14.0), settings, frame=frame)
        else:
            hit_at(draw(beside, long, pose(14.0), settings, frame=frame), 4.0)
