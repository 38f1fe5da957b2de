"""Renderer: the SDF grid: shapes thinner than its cells, and places of which it holds no value."""

from __future__ import annotations

import numpy as np
import torch
from analytic_fields import Field, box, union
from catalogue import hard_case
from hard_scenes import AT_TEN, FAST, PLAIN, draw, in_plain

from shift3d.render import Beams, SdfGrid


def mapped(beams: Beams, metric: Field):  # type: ignore[no-untyped-def]
    """Return a rendering with a grid of exactly this field, and the grid."""
    space = SdfGrid.of(in_plain(metric), PLAIN, FAST)
    return draw(beams, metric, space=space, frame=PLAIN), space


def spread(count: int = 6) -> Beams:
    """Return beams from the origin to x = 30, up to 0.5 m to either side."""
    y = np.random.default_rng(1).uniform(-0.5, 0.5, count)
    return Beams.from_arrays(np.stack([np.full(count, 30.0), y, 0.3 * y], 1), np.zeros(3))


def first_face(beams: Beams, x: float, found: torch.Tensor) -> None:
    """Check that every beam hits where it meets the plane at this x."""
    assert float((found * beams.directions[:, 0] - x).abs().max()) < 1e-4


@hard_case(
    area="renderer",
    why="a plate 2 cm thick lies between two points of a lattice of 5 cm: interpolation shows free space all along",
    must="the plate is hit",
    guard="the map's error is measured between its points, and what lies within it is in doubt",
)
def a_plate_between_the_points_of_a_map() -> None:
    for at in (-0.975, -0.925, 0.475):
        rendering, space = mapped(spread(), box((0.0098, 0.5, 0.5), (at, 0.0, 0.0)))
        first_face(spread(), 10.0 + at - 0.0098, rendering.range_m)
        assert space.error_m > 0.02


@hard_case(
    area="renderer",
    why="such a plate 5 cm in front of a body shows in the SDF grid as a fall into the body that flattens for a while",
    must="the plate is hit, not the body",
    guard="a crossing is taken from the map only where the distance falls all the way, at no flat angle",
)
def a_plate_close_to_a_body() -> None:
    for at in np.linspace(-1.0, -0.95, 8).tolist():
        metric = union(box((0.01, 0.5, 0.5), (at, 0.0, 0.0)), box((0.5, 0.6, 0.6), (at + 0.56, 0.0, 0.0)))
        rendering, _ = mapped(spread(), metric)
        first_face(spread(), 10.0 + at - 0.01, rendering.range_m)


@hard_case(
    area="renderer",
    why="a plate 8 cm in front of a body makes the mapped distance fall, rise and fall again",
    must="the plate is hit, not the body",
    guard="what does not fall all the way is marched",
)
def a_plate_farther_from_a_body() -> None:
    for at in np.linspace(-1.0, -0.95, 8).tolist():
        metric = union(box((0.02, 0.5, 0.5), (at, 0.0, 0.0)), box((0.5, 0.6, 0.6), (at + 0.6, 0.0, 0.0)))
        rendering, _ = mapped(spread(), metric)
        first_face(spread(), 10.0 + at - 0.02, rendering.range_m)


@hard_case(
    area="renderer",
    why="a beam that ends before all that the map doubts was never marched: how near it came is not known",
    must="it is searched once the shape grows, and hit",
    guard="the end of a beam is a sample: what covers the way there does not do",
)
def a_beam_that_ends_before_what_the_map_doubts() -> None:
    before, after = box((0.72, 0.5, 0.5)), box((0.775, 0.5, 0.5))
    for end_x in np.linspace(9.23, 9.27, 9).tolist():
        ends = np.array([[end_x, 0.0, 0.0], [30.0, 0.3, 0.0]])
        beams = Beams.from_arrays(ends, np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]))
        first, _ = mapped(beams, before)
        assert first.hit_mask.tolist() == [False, True]
        found = draw(beams, after, AT_TEN.clone().requires_grad_(), warm=first.warm, frame=PLAIN)
        assert found.hit_mask.all()
        first_face(beams, 9.225, found.range_m.detach())
