"""LiDAR beams of a scene: where each starts, where it points, how far it went; and where they first meet an object."""

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
    """Beams x = s + k e of one scene, scene frame, in the order of its points.

    Attributes:
        points: (N, 3) the original returns, metres, in the scene's own dtype; never changed.
        origins: (N, 3) float64 sensor positions s, metres (a broadcast view where all are the same).
        directions: (N, 3) float64 unit vectors e; zero where there is no beam.
        ranges_m: (N,) float64 distances k of the returns; zero where there is no beam.
        carries: (N,) bool, False where a row carries no beam: range zero or not finite.

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
        """Whether these are the other's beams, row by row."""
        parts = ("directions", "ranges_m", "origins")
        return self is other or all(torch.equal(getattr(self, name), getattr(other, name)) for name in parts)

    @staticmethod
    def from_scene(scene: Scene) -> Beams:
        """Beams of a scene, each from its own sensor origin."""
        return Beams.from_arrays(scene.points, scene.origins)

    @staticmethod
    def of_main_sensor(scene: Scene) -> Beams:
        """Beams of a scene, all from one place: where they start if they start in one place, else the scene's origin.

        The paper's model of a sensor; scenes of several sensors call for the effect `origins`.
        """
        origins = scene.origins
        one = bool((origins == origins[:1]).all())
        return Beams.from_arrays(scene.points, origins[0] if one else np.zeros(3))

    @staticmethod
    def from_arrays(points: np.ndarray | Tensor, origins: np.ndarray | Tensor) -> Beams:
        """Beams from returns and sensor origins.

        Args:
            points: (N, 3) returns, metres, scene frame, float32 or float64.
            origins: (N, 3) or (3,) sensor positions, metres, scene frame.

        Raises:
            InputError: shapes that do not fit.
        """
        points_t = torch.as_tensor(np.ascontiguousarray(points) if isinstance(points, np.ndarray) else points)
        origins_t = _origins(origins, points_t)
        if points_t.ndim != 2 or points_t.shape[1] != 3:
            raise InputError(f"points must be (N, 3), not {tuple(points_t.shape)}", where="Beams.from_arrays")
        offset = points_t.double() - origins_t
        ranges = offset.square().sum(-1).sqrt()
        carries = torch.isfinite(ranges) & (ranges > 0)
        directions = torch.where(carries[:, None], offset / ranges.clamp_min(1e-300)[:, None], 0.0)
        return Beams(points_t, origins_t, directions, torch.where(carries, ranges, 0.0), carries)


@dataclass(frozen=True)
class FirstHits:
    """First crossings of g = 0, found by either renderer.

    Attributes:
        index: (M,) beams that hit, ascending.
        range_m: (M,) float64 distance of the crossing from the sensor.
        residual_m: (M,) float64 |metric g| there.
        unresolved: (U,) beams that could not be decided, ascending: sensor inside the object, or out of
            iterations. They stay where they are.
    """

    index: Tensor
    range_m: Tensor
    residual_m: Tensor
    unresolved: Tensor

    @staticmethod
    def none() -> FirstHits:
        """No hit and nothing unresolved."""
        index, value = torch.empty(0, dtype=torch.long), torch.empty(0, dtype=torch.float64)
        return FirstHits(index, value, value, index)


def _origins(origins: np.ndarray | Tensor, points: Tensor) -> Tensor:
    if isinstance(origins, np.ndarray):
        if origins.ndim == 2 and origins.strides[0] == 0 and len(origins) > 0:
            origins = origins[0]
        origins = torch.from_numpy(np.array(origins, dtype=np.float64))
    origins = origins.double()
    if origins.shape[-1:] != (3,) or origins.ndim > 2 or (origins.ndim == 2 and len(origins) != len(points)):
        raise InputError(f"origins must be (3,) or (N, 3), not {tuple(origins.shape)}", where="Beams.from_arrays")
    return origins.expand(len(points), 3) if origins.ndim == 1 else origins
