"""LiDAR beams of a scene, and the first hits of beams on an object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from shift3d.errors import InputError

if TYPE_CHECKING:
    from shift3d.scenes.scene import Scene


@dataclass(frozen=True)
class Beams:
    """Beams x = s + k e of one scene in the scene frame, in the order of the scene's points.

    Attributes:
        points: (N, 3) original returns, metres, in the scene's own dtype; never changed.
        origins: (N, 3) float64 sensor positions s, metres (a broadcast view if all positions are equal).
        directions: (N, 3) float64 unit vectors e; zero for a row without a beam.
        ranges_m: (N,) float64 ranges k of the returns; zero for a row without a beam.
        carries: (N,) bool mask of the rows that carry a beam; False if the range is zero or not finite.
    Source: SHIFT3D, Algorithm 1, lines 1 and 2.
    """

    points: Tensor
    origins: Tensor
    directions: Tensor
    ranges_m: Tensor
    carries: Tensor

    def __len__(self) -> int:
        return int(self.points.shape[0])

    def same_as(self, other: Beams) -> bool:
        """True if the beams equal those of `other` row by row."""
        parts = ("directions", "ranges_m", "origins")
        return self is other or all(torch.equal(getattr(self, name), getattr(other, name)) for name in parts)

    @staticmethod
    def from_scene(scene: Scene) -> Beams:
        """Build the beams of a scene, each from its own sensor origin."""
        return Beams.from_arrays(scene.points, scene.origins)

    @staticmethod
    def of_main_sensor(scene: Scene) -> Beams:
        """Build the beams of a scene with one common origin, as in the paper's model of a sensor.

        The origin is the sensor position that all beams share, else that of the scene frame. For several sensors use
        the effect `origins`.
        """
        origins = scene.origins
        one = bool((origins == origins[:1]).all())
        return Beams.from_arrays(scene.points, origins[0] if one else np.zeros(3))

    @staticmethod
    def from_arrays(points: np.ndarray | Tensor, origins: np.ndarray | Tensor) -> Beams:
        """Build beams from returns and sensor origins.

        Args:
            points: (N, 3) returns, metres, scene frame, float32 or float64.
            origins: (N, 3) or (3,) sensor positions, metres, scene frame.
        Raises: InputError: shapes that do not fit, or points of another dtype: hits would be rounded to it.
        """
        points_t = torch.as_tensor(np.ascontiguousarray(points) if isinstance(points, np.ndarray) else points)
        origins_t = _origins(origins, points_t)
        if points_t.ndim != 2 or points_t.shape[1] != 3:
            raise InputError(f"points must be (N, 3), not {tuple(points_t.shape)}", where="Beams.from_arrays")
        if points_t.dtype not in (torch.float32, torch.float64):
            what = f"points have dtype {str(points_t.dtype).removeprefix('torch.')}, not float32 or float64"
            raise InputError(what, "Beams.from_arrays", "Cast them to float32, in metres")
        offset = points_t.double() - origins_t
        ranges = offset.square().sum(-1).sqrt()
        carries = torch.isfinite(ranges) & (ranges > 0)
        directions = torch.where(carries[:, None], offset / ranges.clamp_min(1e-300)[:, None], 0.0)
        return Beams(points_t, origins_t, directions, torch.where(carries, ranges, 0.0), carries)


@dataclass(frozen=True)
class FirstHits:
    """First crossings of g = 0 along beams, found by any of the solvers.

    Attributes:
        index: (M,) indices of the beams that hit, ascending.
        range_m: (M,) float64 range of the crossing from the sensor.
        residual_m: (M,) float64 |metric g| at the crossing.
        unresolved: (U,) undecided beams, ascending, whose points stay: the sensor is inside the object, the field is
            not finite, or the iterations ran out.
    """

    index: Tensor
    range_m: Tensor
    residual_m: Tensor
    unresolved: Tensor


def _origins(origins: np.ndarray | Tensor, points: Tensor) -> Tensor:
    if isinstance(origins, np.ndarray):
        if origins.ndim == 2 and origins.strides[0] == 0 and len(origins) > 0:
            origins = origins[0]
        origins = torch.from_numpy(np.array(origins, dtype=np.float64))
    origins = origins.double()
    if origins.shape[-1:] != (3,) or origins.ndim > 2 or (origins.ndim == 2 and len(origins) != len(points)):
        raise InputError(f"origins must be (3,) or (N, 3), not {tuple(origins.shape)}", where="Beams.from_arrays")
    return origins.expand(len(points), 3) if origins.ndim == 1 else origins
