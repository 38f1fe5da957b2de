"""Seeded rejection sampling of poses for an object in a scene."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from shift3d.geometry.boxes import corners_bev
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
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.scenes.ground_map import GroundMap

_OBSTACLE_HEIGHT_M = 0.3
_CLEARANCE_M = 0.1
REFUSALS = {
    "neighbour": "a labelled vehicle too near",
    "unlabelled": "the data set labels nothing there",
    "off_road": "off the map's drivable area",
    "ground": "no ground seen",
    "slope": f"ground steeper than {100 * MAX_SLOPE:.0f} %",
    "occupied": "something stands there",
    "hidden": "hidden by what stands before it",
    "points": "too few beams reach it",
    "contact": "touches nothing",
    "overlap": "reaches into something",
}
"""Reasons to reject a position, in the order of the tests. In `place`, `points` includes hidden positions, because only
beams that are not occluded are counted; `survey` tells the two apart."""


@dataclass(frozen=True)
class PlacementLimits:
    """Region and number of attempts of the sampling.

    min_range_m, max_range_m: horizontal distance from the sensor. sector: (centre, half width) azimuth in radians.
    attempts: largest number of positions to try.

    Source: SHIFT3D, Setup: between 15 and 50 m, heading uniform. The scene set defines the sector.
    """

    min_range_m: float = 15.0
    max_range_m: float = 50.0
    sector: tuple[float, float] = (0.0, math.pi)
    attempts: int = 400


ANYWHERE = PlacementLimits()
"""The paper's ranges at any azimuth."""


@dataclass(frozen=True)
class Placement:
    """Valid pose theta (6,) float64 and its rendering. rejected: number of earlier attempts rejected per reason."""

    theta: Tensor
    check: ConstraintCheck
    rendering: Rendering
    attempts: int
    rejected: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class NoPlacement:
    """Result if no attempt found a valid pose. rejected: number of attempts rejected per reason."""

    attempts: int
    rejected: dict[str, int]


def format_refusals(rejected: Mapping[str, int]) -> str:
    """Format the reasons in words with their counts, most frequent first."""
    ordered = sorted(rejected.items(), key=lambda pair: (-pair[1], list(REFUSALS).index(pair[0])))
    return ", ".join(f"{REFUSALS[name]} {count}" for name, count in ordered)


@dataclass(frozen=True)
class PlacementContext:
    """Scene data for the tests of a position.

    beams: of the scene. others: (M, 2) centres of the scene's vehicles, which the object must not come near.
    ground_map: its heights replace ground_z_m, and it must allow the corners of the footprint. unlabelled: (Z, 2)
    returns in regions where the data set labels no vehicles.
    """

    beams: Beams
    ground_z_m: float
    others: Tensor | None = None
    ground_map: GroundMap | None = None
    unlabelled: np.ndarray | None = None

    @functools.cached_property
    def returns(self) -> np.ndarray:
        """Returns of the beams, (N, 3) float64."""
        return self.beams.points[self.beams.carries].double().numpy()

    def is_labelled(self, xy: tuple[float, float], clear_m: float) -> bool:
        """True if at most half of the returns within clear_m are in unlabelled regions of the data set."""
        if self.unlabelled is None:
            return True
        within, of = (
            int((np.hypot(part[:, 0] - xy[0], part[:, 1] - xy[1]) < clear_m).sum())
            for part in (self.unlabelled, self.returns)
        )
        return 2 * within <= of

    def ground_at(self, x_m: float, y_m: float) -> float:
        """Return the nominal height of the ground, metres."""
        known = None if self.ground_map is None else self.ground_map.height_at(x_m, y_m)
        return self.ground_z_m if known is None else known

    def allows(self, draw: tuple[float, float, float], size: Tensor) -> bool:
        """True if the map allows a footprint of this size at (x, y, yaw)."""
        if self.ground_map is None:
            return True
        box = np.array([[draw[0], draw[1], 0.0, *size.tolist(), draw[2]]])
        return all(self.ground_map.allows(float(x), float(y)) for x, y in corners_bev(box)[0])


def place(
    site: PlacementContext,
    sdf: Field,
    vehicle: VehicleFrame,
    rng: np.random.Generator,
    limits: PlacementLimits = ANYWHERE,
    constraints: Constraints = PAPER_CONSTRAINTS,
    settings: RenderSettings = STANDARD,
) -> Placement | NoPlacement:
    """Sample a random pose that satisfies every constraint.

    Range and azimuth are uniform in the limits, heading in [0, 2 pi). Height, pitch and roll follow the ground under
    the wheels; then snap to ground moves the object (at most 6 cm) until it just touches a return. Cheap tests come
    first: ground visible, no obstacle, enough beams through the box. After each quarter of the attempts the range
    interval beyond min_range_m is halved, because far positions may never get enough points (with 64 beams no object
    gets 300 returns at 35 m).

    If all attempts fail, positions without ground are tried again with a thorough ground search. This second pass does
    not change the result of scenes with a valid pose in the first pass.

    Args: site: facts of the scene, such as from `task.places.placement_context_of`. sdf: field of the vehicle's code,
    sdf frame, in `settings.dtype`. vehicle: scale, axes and size. settings: of the renderings that count returns.
    Returns: the pose with its rendering, or `NoPlacement` with the reasons. Not differentiable.
    Deterministic for a given rng state. Source: SHIFT3D, Setup and Hyper-parameters; the sampling is our choice.
    """
    # Placement needs only the hit mask, so a vehicle too large for the tolerance is rendered to the dtype's limit.
    reachable = settings.reachable_residual_m(float(vehicle.scale_m))
    settings = settings.with_(tolerance_m=max(settings.tolerance_m, reachable))
    metric = ObjectField.of(sdf, vehicle, settings.dtype, settings.batch)
    size = torch.as_tensor(np.asarray(vehicle.size_m, dtype=np.float64))
    rejected: Counter[str] = Counter()

    def stand(draw: tuple[float, float, float], thorough: bool) -> tuple[Tensor, ConstraintCheck, Rendering] | str:
        on_ground = pose_on_ground(draw, site, size, constraints, thorough)
        if isinstance(on_ground, str):
            return on_ground
        theta = snap_to_ground(metric, _near(site.beams, on_ground, size), on_ground, size, reach_m=0.06)
        if theta is None:
            return "contact"
        with torch.no_grad():
            rendering = render(site.beams, sdf, theta, vehicle, settings)
        held = check(metric, _near(site.beams, theta, size), theta, size, rendering.object_points, constraints)
        if not held.valid:
            return "points" if not held.points_ok else "overlap" if not held.overlap_ok else "contact"
        return theta, held, rendering

    unseen = []
    for attempt in range(1, limits.attempts + 1):
        outcome = stand(draw := draw_position(rng, limits, attempt), thorough=False)
        if not isinstance(outcome, str):
            return Placement(*outcome, attempt, dict(rejected))
        rejected[outcome] += 1
        unseen += [draw] if outcome == "ground" else []
    for draw in unseen:
        rejected["ground"] -= 1
        outcome = stand(draw, thorough=True)
        if not isinstance(outcome, str):
            return Placement(*outcome, limits.attempts, dict(+rejected))
        rejected[outcome] += 1
    return NoPlacement(limits.attempts, dict(+rejected))


def draw_position(rng: np.random.Generator, limits: PlacementLimits, attempt: int) -> tuple[float, float, float]:
    """Draw (x, y, yaw) of one attempt; always takes three numbers from rng."""
    halvings = (attempt - 1) * 4 // limits.attempts
    reach = (limits.max_range_m - limits.min_range_m) / 2**halvings
    range_m = limits.min_range_m + reach * rng.random()
    azimuth = limits.sector[0] + limits.sector[1] * (2.0 * rng.random() - 1.0)
    return range_m * math.cos(azimuth), range_m * math.sin(azimuth), 2.0 * math.pi * rng.random()


def pose_on_ground(
    draw: tuple[float, float, float],
    site: PlacementContext,
    size: Tensor,
    constraints: Constraints,
    thorough: bool = True,
) -> Tensor | str:
    """Return the pose (6,) of a box on the ground at (x, y, yaw), or a key of `REFUSALS`. thorough: `ground_under`."""
    x, y, yaw = draw
    if not is_clear(torch.tensor(draw, dtype=torch.float64), site.others, constraints.clear_m):
        return "neighbour"
    if not site.is_labelled((x, y), constraints.clear_m):
        return "unlabelled"
    if not site.allows(draw, size):
        return "off_road"
    plane = ground_under(site.returns, (x, y), site.ground_at(x, y), float(size[:2].norm()) / 2 + 0.5, thorough)
    if plane is None:
        return "ground"
    if plane.slope > MAX_SLOPE:
        return "slope"
    theta = pose_on_plane((x, y), yaw, plane.height_m, plane.attitude(yaw), float(size[2]))
    if _obstacles(_near(site.beams, theta, size), theta, size):
        return "occupied"
    seen = len(rays_in_box(site.beams, theta, Box(-size / 2, size / 2)))
    return theta if seen >= constraints.min_object_points else "points"


def _near(beams: Beams, theta: Tensor, size: Tensor) -> Tensor:
    return points_near(beams, theta, float(size.norm()) / 2 + 0.6)


def pose_on_plane(
    xy: tuple[float, float], yaw: float, height_m: float, attitude: tuple[float, float], object_height_m: float
) -> Tensor:
    """Compute the pose (6,) float64 that puts the middle of a box's bottom on a plane of this height and attitude."""
    pitch, roll = attitude
    lift = 0.5 * object_height_m * math.cos(pitch) * math.cos(roll)
    # Ignores that the centre moves along the plane's normal: at `MAX_SLOPE` sideways by a twentieth of the height.
    return torch.tensor([xy[0], xy[1], height_m + lift, yaw, pitch, roll], dtype=torch.float64)


def _obstacles(near: Tensor, theta: Tensor, size: Tensor) -> bool:
    """True if a point in the object's box is higher than a kerb."""
    x_object = object_from_scene(near, theta)
    half = size / 2 + torch.tensor([_CLEARANCE_M, _CLEARANCE_M, 0.0], dtype=torch.float64)
    inside = (x_object.abs() <= half).all(-1)
    return bool((x_object[inside, 2] > -half[2] + _OBSTACLE_HEIGHT_M).any())
