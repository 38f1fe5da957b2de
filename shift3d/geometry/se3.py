"""Six-parameter poses of the paper, differentiable in torch.

A pose theta is (x, y, z, yaw, pitch, roll) of the object in the scene frame. The paper writes
T(x; theta) = R(yaw) R(pitch) R(roll) [x - t] for the map from sensor to object and leaves the sense of the angles open.
Our choice: yaw, pitch and roll are the object's attitude, so that yaw is the heading of its box. The rotation of the
object in the scene is Rz(yaw) Ry(pitch) Rx(roll), and the map from scene to object is its inverse: x_object = (Rz Ry
Rx)^T (x_scene - t). By the right-hand rule about +y (left), positive pitch lowers the nose.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def scene_R_object(pose: Tensor) -> Tensor:
    """Compute the rotation that turns object axes into scene axes.

    Args:
        pose: (6,) x, y, z in metres, yaw, pitch, roll in radians.

    Returns: (3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), dtype of ``pose``.

    Differentiable w.r.t. ``pose``; independent of its translation. Source: SHIFT3D supplement, Pose Transformation;
    sense of the angles: our choice, see the module.
    """
    cy, cp, cr = torch.cos(pose[3:]).unbind()
    sy, sp, sr = torch.sin(pose[3:]).unbind()
    rows = (
        torch.stack((cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr)),
        torch.stack((sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr)),
        torch.stack((-sp, cp * sr, cp * cr)),
    )
    return torch.stack(rows)


def object_from_scene(points: Tensor, pose: Tensor) -> Tensor:
    """Transform scene points (N, 3) into the object frame (N, 3), metres: T(x; theta).

    Differentiable with respect to both arguments. Source: SHIFT3D supplement, Pose Transformation.
    """
    # Row vectors: (R^T v)^T = v^T R.
    return (points - pose[:3]) @ scene_R_object(pose)


def scene_from_object(points: Tensor, pose: Tensor) -> Tensor:
    """Transform object points (N, 3) into the scene frame (N, 3), metres: inverse of :func:`object_from_scene`."""
    return points @ scene_R_object(pose).T + pose[:3]


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi)."""
    wrapped = math.fmod(angle_rad + math.pi, 2.0 * math.pi)
    return wrapped + math.pi if wrapped < 0.0 else wrapped - math.pi
