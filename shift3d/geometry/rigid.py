"""Rigid transforms as (4, 4) float64 matrices ``dst_SE3_src``, and conversions from the notations of data sets.

Not differentiable. The differentiable poses of inserted objects are in `geometry.se3`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError

Float = NDArray[np.float64]

_TOLERANCE = 1e-3  # of R Rᵀ: published matrices and quaternions are float32 or rounded to six digits


def from_quaternion(wxyz: NDArray[np.floating], translation_m: NDArray[np.floating], where: str) -> Float:
    """Convert quaternions (..., 4), scalar first, and translations (..., 3), metres, to transforms (..., 4, 4).

    Raises InputError: a quaternion whose length differs from 1 by more than a thousandth, or NaN.
    """
    q, t = np.asarray(wxyz, np.float64), np.asarray(translation_m, np.float64)
    length = np.linalg.norm(q, axis=-1)
    if not (np.abs(length - 1.0) <= _TOLERANCE).all() or not np.isfinite(t).all():
        raise InputError("a pose that is no unit quaternion with a finite translation", where, "Copy the file again.")
    w, x, y, z = np.moveaxis(q / length[..., None], -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return rigid(np.stack([np.stack(row, axis=-1) for row in rows], axis=-2), t)


def rigid(rotation: Float, translation_m: Float) -> Float:
    """Join rotations (..., 3, 3) and translations (..., 3) to transforms (..., 4, 4)."""
    pose = np.zeros((*rotation.shape[:-2], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = rotation, translation_m, 1.0
    return pose


def rotation_of_angles(roll: NDArray[np.floating], pitch: NDArray[np.floating], yaw: NDArray[np.floating]) -> Float:
    """Compute Rz(yaw) Ry(pitch) Rx(roll) for angles (...) in radians: (..., 3, 3)."""
    angles = (np.asarray(angle, np.float64) for angle in (roll, pitch, yaw))
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in angles)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def validate_rigid(dst_SE3_src: Float, where: str) -> None:
    """Refuse a matrix that is not a rotation with a translation.

    Raises InputError: NaN, a mirror image, or axes that are not at right angles and of length 1.
    """
    rotation = dst_SE3_src[:3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        askew = np.abs(rotation @ rotation.T - np.eye(3)).max()
        upright = np.abs(dst_SE3_src[3] - (0.0, 0.0, 0.0, 1.0)).max() <= _TOLERANCE
    # NaN fails every comparison in this form.
    if not (askew <= _TOLERANCE and np.linalg.det(rotation) > 0.0 and upright and np.isfinite(dst_SE3_src).all()):
        raise InputError("a transform that is no rotation and translation", where, "Copy the file again.")


def inverse(dst_SE3_src: Float) -> Float:
    """Invert transforms (..., 4, 4): src_SE3_dst."""
    turned = np.swapaxes(dst_SE3_src[..., :3, :3], -1, -2)
    return rigid(turned, -np.einsum("...ij,...j->...i", turned, dst_SE3_src[..., :3, 3]))


def moved(points: NDArray[np.floating], dst_SE3_src: Float) -> Float:
    """Transform points (N, 3) from frame src to frame dst, by one transform (4, 4) or one a point (N, 4, 4)."""
    turned: Float = np.einsum("...ij,...j->...i", dst_SE3_src[..., :3, :3], np.asarray(points, np.float64))
    return turned + dst_SE3_src[..., :3, 3]


def heading_of(dst_SE3_src: Float) -> Float:
    """Compute the heading (...) of src's x axis in dst, radians: counter-clockwise from +x, without the tilt."""
    result: Float = np.arctan2(dst_SE3_src[..., 1, 0], dst_SE3_src[..., 0, 0])
    return result


def interpolate_poses(times: NDArray[np.int64], poses: Float, at: NDArray[np.int64]) -> Float:
    """Interpolate poses linearly. The poses must lie so close together that a chord can replace an arc.

    Args:
        times: (K,) ascending, K >= 1. poses: (K, 4, 4). at: (N,) in the unit of times; constant beyond both ends.

    Rotations are blended and orthogonalized; the error for 10 ms steps at 1 rad/s is below 1e-5 rad.
    """
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1)) if len(times) > 1 else np.zeros(len(at), int)
    before = np.maximum(after - 1, 0)
    gap = np.maximum(times[after] - times[before], 1)
    share = np.clip((at - times[before]) / gap, 0.0, 1.0)[:, None, None]
    blend: Float = (1.0 - share) * poses[before] + share * poses[after]
    u, _, vt = np.linalg.svd(blend[:, :3, :3])
    blend[:, :3, :3] = u @ vt
    return blend
