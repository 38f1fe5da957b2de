"""What turns of sensors brought back, as rows of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.sensor import NoReturnBeams
from shift3d.scenes.street.behind import Cells
from shift3d.scenes.street.raycast import Sweep

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Echoes:
    """Returns of one turn, or of several one after the other.

    Attributes:
        points, origins: (K, 3) float32 in the frame the scene is given in; origins a view of one row where they can.
        reflectance, time_s: (K,) float32. pixel: (K, 2) int32, row and column in the sensor's range image.
    """

    points: Float32
    origins: Float32
    reflectance: Float32
    time_s: Float32
    pixel: NDArray[np.int32]

    @staticmethod
    def of(sweep: Sweep, cells: Cells, range_m: Float32, reflectance: Float32, compensated: bool) -> Echoes:
        """Returns of some beams of a sweep.

        Args:
            cells: row and column of each; range_m, reflectance: (K,).
            compensated: points as they were at time 0; otherwise in the frame of the sensor as it fires.
        """
        row, column = cells
        points = (sweep.directions[row, column] * range_m[:, None]).astype(np.float32)
        starts = _origins_of_columns(sweep, compensated)
        if starts.any():  # not for the origin: adding zero turns -0.0 into 0.0
            points = (points + starts[column if len(starts) > 1 else 0]).astype(np.float32)
        pixel = np.stack(cells, axis=1).astype(np.int32)
        times = sweep.sensor.firing_times_s()[column].astype(np.float32)
        return Echoes(points, _origins(starts, column), reflectance, times, pixel)

    @staticmethod
    def of_kept(
        sweep: Sweep, kept: NDArray[np.bool_], range_m: Float32, reflectance: Float32, compensated: bool
    ) -> Echoes:
        """Those of a sweep that were kept, row by row; arguments (rows, columns)."""
        row, column = np.nonzero(kept)
        return Echoes.of(sweep, (row, column), range_m[kept], reflectance[kept], compensated)

    @staticmethod
    def joined(parts: Sequence[Echoes]) -> Echoes:
        """One after the other."""
        if len(parts) == 1:
            return parts[0]
        origins = np.concatenate([part.origins for part in parts])
        if not (origins != origins[:1]).any():
            origins = np.broadcast_to(origins[:1].copy(), origins.shape)
        return Echoes(
            np.concatenate([part.points for part in parts]),
            origins,
            np.concatenate([part.reflectance for part in parts]),
            np.concatenate([part.time_s for part in parts]),
            np.concatenate([part.pixel for part in parts]),
        )


def no_return_beams(sweeps: Sequence[tuple[Sweep, NDArray[np.bool_]]], compensated: bool) -> NoReturnBeams:
    """The beams of sweeps, each with what it kept (rows, columns), that brought nothing back, row by row."""
    origins, directions, times = [], [], []
    for sweep, kept in sweeps:
        row, column = np.nonzero(~kept)
        directions.append(sweep.directions[row, column])
        origins.append(_origins(_origins_of_columns(sweep, compensated), column))
        times.append(sweep.sensor.firing_times_s()[column].astype(np.float32))
    together = origins[0] if len(origins) == 1 else np.concatenate(origins)
    return NoReturnBeams(together, np.concatenate(directions), np.concatenate(times))


def _origins_of_columns(sweep: Sweep, compensated: bool) -> NDArray[np.float64]:
    """(1, 3) or (columns, 3): where beams start in the frame that points are given in."""
    return sweep.origins_m if compensated else np.array(sweep.mount.origin_m)[None]


def _origins(starts: NDArray[np.float64], column: NDArray[np.intp]) -> Float32:
    if len(starts) == 1:
        return np.broadcast_to(starts.astype(np.float32), (len(column), 3))
    return starts[column].astype(np.float32)
