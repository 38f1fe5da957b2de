"""Fit of the ground under an object: a plane through the returns around its footprint."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_SLOPE = 0.10
"""Steepest ground for a vehicle: the paper's largest pitch and roll, 0.1 rad, and about the steepest slope in published
road standards for streets with through traffic (8 to 12 %)."""
_INLIER_M = 0.06
_BELOW_M, _BELOW_SHARE = 0.15, 0.1
_MIN_POINTS = 12
_MIN_BREADTH_M = 1.0
_WIDER = (1.0, 1.75, 2.5)  # search radii, in units of radius_m: a wider one reaches scan lines beside the footprint
_TRIPLES = 80
_SPACING_M = 0.4  # of points that represent the ground: less than a wheel's length; at 0.25 a step takes 5 % longer


@dataclass(frozen=True)
class GroundPlane:
    """Plane z = height_m + slope_x (x - x0) + slope_y (y - y0) fitted around the position (x0, y0)."""

    height_m: float
    slope_x: float
    slope_y: float

    @property
    def slope(self) -> float:
        """Slope in the steepest direction, metres per metre."""
        return math.hypot(self.slope_x, self.slope_y)

    def is_lowest(self, local: Array) -> bool:
        """True if at most a tenth of the points (N, 3), relative to (x0, y0), are more than 15 cm below the plane."""
        below = local[:, 2] - self.height_m - local[:, :2] @ (self.slope_x, self.slope_y) < -_BELOW_M
        return bool(below.mean() <= _BELOW_SHARE)

    def lowered(self, centre_xy: tuple[float, float], radius_m: float, depth_m: float) -> Array:
        """Sample points (N, 3), depth_m below the plane, every 40 cm within radius_m. centre_xy: (x0, y0)."""
        steps = np.arange(-radius_m, radius_m + _SPACING_M, _SPACING_M)
        local = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        local = local[np.hypot(local[:, 0], local[:, 1]) <= radius_m]
        height = self.height_m - depth_m + local @ (self.slope_x, self.slope_y)
        return np.column_stack((local + np.asarray(centre_xy), height))

    def attitude(self, yaw_rad: float) -> tuple[float, float]:
        """Compute (pitch, roll) in radians that align an object of this heading with the plane.

        A rise ahead lifts the nose, which is a NEGATIVE pitch (right-hand rule about +y).
        """
        forward = math.cos(yaw_rad) * self.slope_x + math.sin(yaw_rad) * self.slope_y
        left = -math.sin(yaw_rad) * self.slope_x + math.cos(yaw_rad) * self.slope_y
        pitch = -math.atan(forward)
        return pitch, math.atan(left * math.cos(pitch))


def ground_under(
    points: Array, centre_xy: tuple[float, float], nominal_z_m: float, radius_m: float, thorough: bool = True
) -> GroundPlane | None:
    """Fit the ground by `fit_ground`, and if it fails (long slopes, roofs, sparse scan lines) by RANSAC.

    RANSAC takes the plane through three returns that has the most returns, with a slope of at most 1.5 `MAX_SLOPE`; the
    number of returns seeds the triples. The search radius grows up to 2.5 times; enough returns within radius_m must be
    on the plane. The result may be steeper than `MAX_SLOPE`: the caller reports that. For both methods at most a tenth
    of the returns may be more than 15 cm below the plane, since a roof has ground below.

    thorough: False skips RANSAC. Other arguments and source: see `fit_ground`. RANSAC: Fischler and Bolles 1981.
    """
    points = points[np.abs(points[:, 0] - centre_xy[0]) <= _WIDER[-1] * radius_m]  # keeps few points: saves time below
    offset = points[:, :2] - np.asarray(centre_xy)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    found, around = fit_ground(points, centre_xy, nominal_z_m, radius_m), distance <= radius_m
    if found is not None and found.is_lowest(np.column_stack((offset[around], points[around, 2]))):
        return found
    if not thorough:
        return None
    # The largest height difference is that of ground at the steepest slope from the sensor to the position.
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
    """Fit a plane to the ground returns within radius_m of a position; return None if too little ground is visible.

    The fit starts with returns within 0.6 m of the nominal height, plus 3 cm per metre of distance (ground may slope).
    It refits to returns in a narrower band each time, which excludes walls and poles. It returns None for returns along
    a single scan line, which do not determine the slope across the line, and for a slope above `MAX_SLOPE`.

    Args:
        points: (N, 3) returns, scene frame.
        centre_xy: position, scene frame, metres.
        nominal_z_m: height of the ground around the sensor.

    Source: our choice: the paper is silent.
    """
    offset = points[:, :2] - np.asarray(centre_xy)
    near = np.einsum("ij,ij->i", offset, offset) <= radius_m**2
    xy, z = offset[near], points[near, 2]
    keep = np.abs(z - nominal_z_m) < 0.6 + 0.03 * math.hypot(*centre_xy)
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
    found = GroundPlane(*plane.tolist())
    return found if keep.sum() >= _MIN_POINTS and found.slope <= MAX_SLOPE else None


def _consensus(local: Array, radius_m: float) -> GroundPlane | None:
    """Find the plane with the most points, and refit it to them; None if no plane is ground. local: (N, 3)."""
    if not _spans_a_plane(local[:, :2]):
        return None
    xy, z = local[:, :2], local[:, 2]
    rows = np.random.default_rng(len(local)).integers(0, len(local), (_TRIPLES, 3))
    design = np.concatenate((np.ones((_TRIPLES, 3, 1)), xy[rows]), axis=2)
    # The determinant is twice the triangle's area; thin triangles do not determine the slope across them.
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
    return GroundPlane(*plane.tolist()) if borne else None


def _spans_a_plane(xy: Array) -> bool:
    """True if positions (N, 2) are enough and spread at least _MIN_BREADTH_M across their principal direction."""
    if len(xy) < _MIN_POINTS:
        return False
    offset = xy - xy.mean(axis=0)
    across = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    return float(np.ptp(offset @ across)) >= _MIN_BREADTH_M


def _through(xy: Array, z: Array) -> Array:
    """Fit the least-squares plane: (3,) height at the position and the two slopes."""
    found = np.linalg.lstsq(np.column_stack((np.ones(len(xy)), xy)), z, rcond=None)
    return found[0].astype(np.float64)
