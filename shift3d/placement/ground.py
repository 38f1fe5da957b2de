"""The ground under an object: a plane through the returns around its footprint."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_SLOPE = 0.10
_INLIER_M = 0.06
_MIN_POINTS = 12
_MIN_BREADTH_M = 1.0


@dataclass(frozen=True)
class GroundPlane:
    """z = height_m + slope_x (x - x0) + slope_y (y - y0) about the point (x0, y0) it was fitted at."""

    height_m: float
    slope_x: float
    slope_y: float

    def attitude(self, yaw_rad: float) -> tuple[float, float]:
        """(pitch, roll) in radians that lay an object of this heading on the plane.

        Uphill ahead raises the nose, which is a NEGATIVE pitch (right-hand rule about +y).
        """
        forward = math.cos(yaw_rad) * self.slope_x + math.sin(yaw_rad) * self.slope_y
        left = -math.sin(yaw_rad) * self.slope_x + math.cos(yaw_rad) * self.slope_y
        pitch = -math.atan(forward)
        return pitch, math.atan(left * math.cos(pitch))


def fit_ground(
    points: Array, centre_xy: tuple[float, float], nominal_z_m: float, radius_m: float
) -> GroundPlane | None:
    """Plane through the ground returns within radius_m of a place; None where too little ground is seen.

    Starts from the nominal plane widened to 0.6 m, refits on what lies near the fit, narrower each time, so
    that walls and poles fall out. A slope beyond 10 % is refused, and so are returns along one scan line: whatever
    its direction, they leave the slope across it open.

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
        design = np.column_stack((np.ones(int(keep.sum())), xy[keep]))
        if len(design) < _MIN_POINTS or _breadth(xy[keep]) < _MIN_BREADTH_M:
            return None
        plane = np.linalg.lstsq(design, z[keep], rcond=None)[0]
        keep = np.abs(plane[0] + xy @ plane[1:] - z) < band
    if keep.sum() < _MIN_POINTS or math.hypot(plane[1], plane[2]) > MAX_SLOPE:
        return None
    return GroundPlane(float(plane[0]), float(plane[1]), float(plane[2]))


def _breadth(xy: Array) -> float:
    """Extent of places (N, 2) across the direction that they are spread along most, metres."""
    offset = xy - xy.mean(axis=0)
    across = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    return float(np.ptp(offset @ across))
