"""Where an object may stand in a scene: seeded rejection sampling."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene
from shift3d.placement.constraints import (
    PAPER_CONSTRAINTS,
    ConstraintCheck,
    Constraints,
    check,
    is_clear,
    points_near,
    snap_to_ground,
)
from shift3d.placement.ground import MAX_SLOPE, ground_under
from shift3d.render.beams import Beams
from shift3d.render.culling import Box, rays_in_box
from shift3d.render.field.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import STANDARD, RenderSettings

_OBSTACLE_HEIGHT_M = 0.3
_CLEARANCE_M = 0.1


@dataclass(frozen=True)
class PlacementLimits:
    """Where to look.

    min_range_m, max_range_m: distance from the sensor, horizontal. sector: (centre, half width) azimuth in
    radians. attempts: places to try before giving up.

    Source: SHIFT3D, Setup: between 15 and 50 m, heading uniform. The sector is the scene set's.
    """

    min_range_m: float = 15.0
    max_range_m: float = 50.0
    sector: tuple[float, float] = (0.0, math.pi)
    attempts: int = 400


ANYWHERE = PlacementLimits()
"""The paper's ranges, all around."""


@dataclass(frozen=True)
class Placement:
    """A place where the object stands, and the rendering that shows it.

    theta: (6,) float64 pose. rejected: how often each reason turned a place down before this one.
    """

    theta: Tensor
    check: ConstraintCheck
    rendering: Rendering
    attempts: int
    rejected: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class NoPlacement:
    """The scene has no place for this object within the attempts; `rejected` says why."""

    attempts: int
    rejected: dict[str, int]

    def reason(self) -> str:
        """One line for a log or a result row."""
        listed = ", ".join(f"{name} {count}" for name, count in sorted(self.rejected.items(), key=lambda p: -p[1]))
        return f"no valid placement in {self.attempts} attempts ({listed})"


def place(
    beams: Beams,
    ground_z_m: float,
    sdf: Field,
    vehicle: VehicleFrame,
    rng: np.random.Generator,
    limits: PlacementLimits = ANYWHERE,
    constraints: Constraints = PAPER_CONSTRAINTS,
    settings: RenderSettings = STANDARD,
    others: Tensor | None = None,
    space: SdfGrid | None = None,
) -> Placement | NoPlacement:
    """A random place that satisfies every constraint.

    Range and azimuth are uniform in the limits, heading in [0, 2 pi); height, pitch and roll follow the
    ground under the wheels, then the object is lowered or raised (at most 6 cm) until it just touches a
    return. Cheap tests come first: ground seen, nothing standing there, enough beams that could meet the box.
    Where far places keep failing for want of points (300 returns at 35 m do not exist with 64 beams), the range is
    drawn nearer: after each quarter of the attempts the interval beyond min_range_m is halved.

    `others` (M, 2) are the centres of the scene's own vehicles, to stay clear of; `space` a map of this field.
    Deterministic for a given rng state. Source: SHIFT3D, Setup and Hyper-parameters; the sampling is our choice.
    """
    metric = ObjectField.of(sdf, vehicle, settings.dtype, settings.batch)
    size = torch.as_tensor(np.asarray(vehicle.size_m, dtype=np.float64))
    carried = beams.points[beams.carries].double().numpy()
    rejected: Counter[str] = Counter()
    for attempt in range(1, limits.attempts + 1):
        draw = _draw(rng, limits, attempt)
        if not is_clear(torch.tensor(draw), others, constraints.clear_m):
            rejected["neighbour"] += 1
            continue
        outcome = _try_place(draw, beams, carried, ground_z_m, metric, size, constraints)
        if isinstance(outcome, str):
            rejected[outcome] += 1
            continue
        with torch.no_grad():
            rendering = render(beams, sdf, outcome, vehicle, settings, grid=space)
        near = points_near(beams, outcome, float(size.norm()) / 2 + 0.6)
        held = check(metric, near, outcome, size, rendering.object_points, constraints)
        if held.valid:
            return Placement(outcome, held, rendering, attempt, dict(rejected))
        rejected["points" if not held.points_ok else "overlap" if not held.overlap_ok else "contact"] += 1
    return NoPlacement(limits.attempts, dict(rejected))


def _draw(rng: np.random.Generator, limits: PlacementLimits, attempt: int) -> tuple[float, float, float]:
    """(x, y, yaw) of one attempt; always three numbers from rng, whatever becomes of them."""
    halvings = (attempt - 1) * 4 // limits.attempts
    reach = (limits.max_range_m - limits.min_range_m) / 2**halvings
    range_m = limits.min_range_m + reach * rng.random()
    azimuth = limits.sector[0] + limits.sector[1] * (2.0 * rng.random() - 1.0)
    return range_m * math.cos(azimuth), range_m * math.sin(azimuth), 2.0 * math.pi * rng.random()


def _try_place(
    draw: tuple[float, float, float],
    beams: Beams,
    carried: np.ndarray,
    ground_z_m: float,
    metric: ObjectField,
    size: Tensor,
    constraints: Constraints,
) -> Tensor | str:
    """The snapped pose, or the reason why not."""
    x, y, yaw = draw
    plane = ground_under(carried, (x, y), ground_z_m, float(size[:2].norm()) / 2 + 0.5)
    if plane is None:
        return "ground"
    if plane.slope > MAX_SLOPE:
        return "slope"
    theta = pose_on_plane((x, y), yaw, plane.height_m, plane.attitude(yaw), float(size[2]))
    near = points_near(beams, theta, float(size.norm()) / 2 + 0.6)
    if _obstacles(near, theta, size):
        return "occupied"
    box = Box(-size / 2, size / 2)
    if len(rays_in_box(beams, theta, box)) < constraints.min_object_points:
        return "points"
    snapped = snap_to_ground(metric, near, theta, size, reach_m=0.06)
    return "contact" if snapped is None else snapped


def pose_on_plane(
    xy: tuple[float, float],
    yaw: float,
    height_m: float,
    attitude: tuple[float, float],
    object_height_m: float,
) -> Tensor:
    """(6,) float64 pose whose box stands with the middle of its bottom on a plane of this height and attitude."""
    pitch, roll = attitude
    lift = 0.5 * object_height_m * math.cos(pitch) * math.cos(roll)
    # The centre lies along the plane's normal above (x, y); sideways that is under 2 % of the height.
    return torch.tensor([xy[0], xy[1], height_m + lift, yaw, pitch, roll], dtype=torch.float64)


def _obstacles(near: Tensor, theta: Tensor, size: Tensor) -> bool:
    """Whether anything higher than a kerb stands in the object's box."""
    x_object = object_from_scene(near, theta)
    half = size / 2 + torch.tensor([_CLEARANCE_M, _CLEARANCE_M, 0.0], dtype=torch.float64)
    inside = (x_object.abs() <= half).all(-1)
    return bool((x_object[inside, 2] > -half[2] + _OBSTACLE_HEIGHT_M).any())
