"""The ground under an object: a plane through the returns around its footprint."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_SLOPE = 0.10
"""Steepest ground that a vehicle is put on: the paper's largest pitch and roll, 0.1 rad, and about the steepest that
published road standards give for streets with through traffic (8 to 12 %)."""
_INLIER_M = 0.06
_BELOW_M, _BELOW_SHARE = 0.15, 0.1
_MIN_POINTS = 12
_MIN_BREADTH_M = 1.0
_WIDER = (1.0, 1.75, 2.5)  # reaches, in radii: where one scan line crosses the footprint, its neighbours are farther
_TRIPLES = 80
_SPACING_M = 0.4  # of points that stand for the ground: less than a wheel is long; at 0.25 a step takes 5 % longer


@dataclass(frozen=True)
class GroundPlane:
    """z = height_m + slope_x (x - x0) + slope_y (y - y0) about the point (x0, y0) it was fitted at."""

    height_m: float
    slope_x: float
    slope_y: float

    @property
    def slope(self) -> float:
        """Steepest rise, metres a metre."""
        return math.hypot(self.slope_x, self.slope_y)

    def is_lowest(self, local: Array) -> bool:
        """Whether at most a tenth of the points (N, 3), about (x0, y0), lie more than 15 cm below."""
        below = local[:, 2] - self.height_m - local[:, :2] @ (self.slope_x, self.slope_y) < -_BELOW_M
        return bool(below.mean() <= _BELOW_SHARE)

    def lowered(self, centre_xy: tuple[float, float], radius_m: float, depth_m: float) -> Array:
        """Points (N, 3) every 40 cm within a radius of its place, depth_m below the plane.

        centre_xy: the place that it was fitted at.
        """
        steps = np.arange(-radius_m, radius_m + _SPACING_M, _SPACING_M)
        local = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        local = local[np.hypot(local[:, 0], local[:, 1]) <= radius_m]
        height = self.height_m - depth_m + local @ (self.slope_x, self.slope_y)
        return np.column_stack((local + np.asarray(centre_xy), height))

    def attitude(self, yaw_rad: float) -> tuple[float, float]:
        """(pitch, roll) in radians that lay an object of this heading on the plane.

        Uphill ahead raises the nose, which is a NEGATIVE pitch (right-hand rule about +y).
        """
        forward = math.cos(yaw_rad) * self.slope_x + math.sin(yaw_rad) * self.slope_y
        left = -math.sin(yaw_rad) * self.slope_x + math.cos(yaw_rad) * self.slope_y
        pitch = -math.atan(forward)
        return pitch, math.atan(left * math.cos(pitch))


def ground_under(
    points: Array, centre_xy: tuple[float, float], nominal_z_m: float, radius_m: float, thorough: bool = True
) -> GroundPlane | None:
    """`fit_ground`, and where that fails: ground that climbs away from its nominal height, roofs, sparse scan lines.

    Then the plane is the one that most returns lie on among those through triples of them (RANSAC; how many returns
    there are seeds the triples), none steeper than `MAX_SLOPE` by more than half. The reach grows up to 2.5 times, as
    long as returns within radius_m bear the plane. The plane may be steeper than `MAX_SLOPE`: the caller says so.

    Either way at most a tenth of the returns may lie more than 15 cm below the plane: a roof has ground below.

    thorough: False leaves the second search out. Other arguments and source: see `fit_ground`. Source of RANSAC:
    Fischler and Bolles 1981.
    """
    points = points[np.abs(points[:, 0] - centre_xy[0]) <= _WIDER[-1] * radius_m]  # few of a scan: the rest is cheap
    offset = points[:, :2] - np.asarray(centre_xy)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    found, around = fit_ground(points, centre_xy, nominal_z_m, radius_m), distance <= radius_m
    if found is not None and found.is_lowest(np.column_stack((offset[around], points[around, 2]))):
        return found
    if not thorough:
        return None
    # Ground rises from its nominal height by no more than the steepest slope all the way.
    near = distance <= _WIDER[-1] * radius_m
    near &= np.abs(points[:, 2] - nominal_z_m) < 0.6 + MAX_SLOPE * math.hypot(*centre_xy)
    local, distance = np.column_stack((offset[near], points[near, 2])), distance[near]
    if (distance <= radius_m).sum() < _MIN_POINTS:
        return None
    planes = (_consensus(local[distance <= reach * radius_m], radius_m) for reach in _WIDER)
    return next((plane for plane in planes if plane is not None), None)


def fit_ground(
    points: Array, centre_xy: tuple[float, float], nominal_z_m: float, radius_m: float
) -> GroundPlane | None:
    """Plane through the ground returns within radius_m of a place; None where too little ground is seen.

    Starts from the nominal plane widened to 0.6 m, refits on what lies near the fit, narrower each time, so
    that walls and poles fall out. Returns along one scan line are refused: whatever its direction, they leave the
    slope across it open. So is a slope beyond `MAX_SLOPE`.

    Args:
        points: (N, 3) returns, scene frame.
        centre_xy: where, scene frame, metres.
        nominal_z_m: height of the ground around the sensor.

    Source: our choice: the paper is silent.
    """
    offset = points[:, :2] - np.asarray(centre_xy)
    near = np.einsum("ij,ij->i", offset, offset) <= radius_m**2
    xy, z = offset[near], points[near, 2]
    # Slopes let the ground leave its nominal height with distance.
    tolerance_m = 0.6 + 0.03 * math.hypot(*centre_xy)
    keep = np.abs(z - nominal_z_m) < tolerance_m
    if keep.sum() < _MIN_POINTS:
        return None
    low = np.quantile(z[keep], 0.2)
    keep &= np.abs(z - low) < 0.5
    plane = np.array([low, 0.0, 0.0])
    for band in (0.25, 0.12, _INLIER_M, _INLIER_M):
        if not _spans_a_plane(xy[keep]):
            return None
        plane = _through(xy[keep], z[keep])
        keep = np.abs(plane[0] + xy @ plane[1:] - z) < band
    if keep.sum() < _MIN_POINTS or math.hypot(plane[1], plane[2]) > MAX_SLOPE:
        return None
    return GroundPlane(float(plane[0]), float(plane[1]), float(plane[2]))


def _consensus(local: Array, radius_m: float) -> GroundPlane | None:
    """The plane that most of the points (N, 3) about the place lie on, refitted to them; None where none is ground."""
    if not _spans_a_plane(local[:, :2]):
        return None
    xy, z = local[:, :2], local[:, 2]
    rows = np.random.default_rng(len(local)).integers(0, len(local), (_TRIPLES, 3))
    design = np.concatenate((np.ones((_TRIPLES, 3, 1)), xy[rows]), axis=2)
    # Twice the triangle's area: thin ones say nothing of the slope across them.
    rows, design = (part[np.abs(np.linalg.det(design)) > _MIN_BREADTH_M] for part in (rows, design))
    if not len(rows):
        return None
    planes = np.linalg.solve(design, z[rows][..., None])[..., 0]
    planes = planes[np.hypot(planes[:, 1], planes[:, 2]) <= 1.5 * MAX_SLOPE]
    above = z - planes @ np.column_stack((np.ones(len(xy)), xy)).T
    on: npt.NDArray[np.bool_] = np.abs(above) < _INLIER_M
    ground = (above < -_BELOW_M).mean(axis=1) <= _BELOW_SHARE
    if not ground.any():
        return None
    keep = on[int(np.argmax(np.where(ground, on.sum(axis=1), -1)))]
    plane = np.zeros(3)
    for _ in range(2):
        if not _spans_a_plane(xy[keep]):
            return None
        plane = _through(xy[keep], z[keep])
        keep = np.abs(plane[0] + xy @ plane[1:] - z) < _INLIER_M
    borne = (keep & (np.einsum("ij,ij->i", xy, xy) <= radius_m**2)).sum() >= _MIN_POINTS
    return GroundPlane(float(plane[0]), float(plane[1]), float(plane[2])) if borne else None


def _spans_a_plane(xy: Array) -> bool:
    """Whether places (N, 2) are enough, and as broad across the direction that they are spread along most."""
    if len(xy) < _MIN_POINTS:
        return False
    offset = xy - xy.mean(axis=0)
    across = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    return float(np.ptp(offset @ across)) >= _MIN_BREADTH_M


def _through(xy: Array, z: Array) -> Array:
    """(3,) height at the place and slopes of the least-squares plane."""
    found = np.linalg.lstsq(np.column_stack((np.ones(len(xy)), xy)), z, rcond=None)
    return found[0].astype(np.float64)
