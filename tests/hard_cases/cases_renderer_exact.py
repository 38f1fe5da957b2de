"""Renderer: traversal of a network's linear regions: bounds that are violated, regions of no length."""

from __future__ import annotations

import math

import torch
from catalogue import hard_case
from hard_scenes import AT_TEN, MANY, PLAIN, BentLine, beams_along_x, hit_at, sound, unmoved

from shift3d.render import Beams, Rendering, preset, render

EXACT = preset("reference")
UNIT = PLAIN.scale_m
START = -8.0
"""Place at which every profile is `level`: outside the decoder's ball, and behind the sensor."""


def traverse(line: BentLine, beams: Beams, max_slope: float = EXACT.max_slope) -> Rendering:
    """Return the reference rendering of a profile whose origin is at x = 10."""
    with torch.no_grad():
        return render(beams, line, AT_TEN, PLAIN, EXACT.with_(max_slope=max_slope))


def plate(steepness: float, at: float = 0.2, half: float = 0.002) -> BentLine:
    """Return steepness (|x - at| - half), sdf units; in mid-slope one unit switches without effect."""
    return BentLine(steepness * (at - START - half), [(START, -steepness), (-0.5, 0.0), (at, 2.0 * steepness)])


@hard_case(
    area="renderer",
    why="a network forty times as steep as a distance is saturated a metre from its surface: no step shows it",
    must="the first crossing, as with no bound at all",
    guard="a beam whose regions are nearly as steep as the bound traverses every region from there",
)
def a_bound_that_does_not_hold_from_the_start() -> None:
    for steepness in (5.0, 40.0):
        for count in (1, MANY):
            hit_at(traverse(plate(steepness), beams_along_x(count=count)), 10.0 + UNIT * 0.198, 1e-8)


@hard_case(
    area="renderer",
    why="a network is gentle where a beam begins and steep where it meets a thin plate in front of a low plain",
    must="the plate is hit, not stepped over",
    guard="a step over which g fell by more than the bound allows is taken back and traversed",
)
def a_bound_that_fails_on_the_way() -> None:
    # 0.2 up to the plate, down to -0.01 and up to 0.01 within 0.03 units, flat behind the plate.
    bends = [(0.2, -14.0), (0.215, 14.0), (0.215, 4.0), (0.22, -4.0)]
    for count in (1, MANY):
        line = BentLine(0.2, bends)
        hit_at(traverse(line, beams_along_x(count=count)), 10.0 + UNIT * (0.2 + 0.2 / 14.0), 1e-8)


@hard_case(
    area="renderer",
    why="a step that relies on the bound ends inside the object",
    must="the crossing that it stepped over is found",
    guard="a beam that turned negative in one step is traversed again from its sensor",
)
def a_surface_before_the_box_of_the_decoder() -> None:
    # The surface is at x = -1.2 units, outside the ball of 1.05 in which the renderer searches for shapes.
    for count in (1, MANY):
        hit_at(traverse(BentLine(-1.2 - START, [(START, -1.0)]), beams_along_x(count=count)), 10.0 - UNIT * 1.2, 1e-8)


@hard_case(
    area="renderer",
    why="regions are shorter than the rounding of a range: going to the end of one goes nowhere",
    must="the traversal ends, with the first crossing",
    guard="every region is a nanometre longer than it says",
)
def regions_shorter_than_a_nanometre() -> None:
    crowd = [(0.1 + i * 1e-3 + j * 1e-17, 0.01 * (-1) ** j) for i in range(40) for j in range(10)]
    for max_slope in (3.0, math.inf):
        line = BentLine(0.2 - START, [(START, -1.0), *crowd])
        hit_at(traverse(line, beams_along_x(), max_slope), 10.0 + UNIT * 0.2, 1e-8)


@hard_case(
    area="renderer",
    why="g levels off a nanometre above zero and falls on steeply: one step along the regions ends just inside",
    must="the root is there, within a nanometre",
    guard="a beam that came along its regions and is inside by a rounding has its root where it is",
)
def a_bend_just_above_the_surface() -> None:
    # Down to `above` at 0.2 units, level for 1e-8, then down ten times as steep as before.
    for above in (5e-10, 1e-9, 2e-9):
        line = BentLine(0.2 + above - START, [(START, -1.0), (0.2, 1.0 - 1e-3), (0.2 + 1e-8, 1e-3 - 10.0)])
        hit_at(traverse(line, beams_along_x()), 10.0 + UNIT * (0.2 + 1e-8 + above / 10.0), 2e-9)


@hard_case(
    area="renderer",
    why="the region on which a beam ends goes on to a root behind its return",
    must="the return stays, be it a micrometre in front of the surface",
    guard="a root on a region counts up to the end of the beam",
)
def a_root_behind_the_return() -> None:
    surface = 10.0 + UNIT * 0.2
    for short in (1e-6, 0.05):
        beams = beams_along_x(end_x=surface - short)
        unmoved(traverse(BentLine(0.2 - START, [(START, -1.0)]), beams), beams)
        hit_at(traverse(BentLine(0.2 - START, [(START, -1.0)]), beams_along_x(end_x=surface + short)), surface, 1e-8)


@hard_case(
    area="renderer",
    why="a beam that starts inside a network's object has no crossing from outside",
    must="it is counted as unresolved, with every bound",
    guard="a traversal that is inside at its sensor counts as unresolved, not as ended",
)
def a_sensor_inside_the_object_of_a_network() -> None:
    beams = beams_along_x(start_x=10.5, count=MANY)
    for max_slope in (3.0, math.inf):
        unmoved(traverse(plate(1.0, half=0.2), beams, max_slope), beams, unresolved=MANY)


@hard_case(
    area="renderer",
    why="a network with a weight that is not a number has regions without value, slope or end",
    must="the beams through it are counted as unresolved and stay",
    guard="a traversal that meets a value that is not finite counts as unresolved, not as ended",
)
def a_network_with_a_weight_of_nan() -> None:
    beams = beams_along_x(count=MANY)
    for value in (math.nan, math.inf, -math.inf):
        for layer in (0, 1):
            line = plate(1.0)
            line.biases[layer][0] = value
            rendering = traverse(line, beams)
            sound(rendering)
            unmoved(rendering, beams, unresolved=MANY)
