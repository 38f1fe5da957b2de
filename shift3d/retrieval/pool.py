"""Pool of vehicles with fitted shapes: the nearest vehicle of a shape, and controls seen under like conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError

Array = NDArray[np.float64]
RANGE_RATIO, POINTS_RATIO = 1.25, 1.5  # largest factors between a control and the matched vehicle


@dataclass(frozen=True, eq=False)
class Pool:
    """N fitted vehicles, in a fixed order. codes: (N, d). range_m, points (their number): (N,). rows: of the table."""

    codes: Array
    range_m: Array
    points: Array
    rows: list[dict[str, Any]]

    @staticmethod
    def of(table: Mapping[str, list[Any]], where: str) -> Pool:
        """Select the fitted vehicles without flags. table: columns of ``vehicle_pool``.

        Raises: InputError if there is none.
        """
        rows = [dict(zip(table, values)) for values in zip(*table.values())]
        rows = [row for row in rows if row["status"] == "fitted" and not row["flags"]]
        if not rows:
            raise InputError("no vehicle could be fitted", where, "Give scenes whose vehicles are labelled")
        columns = [np.array([row[name] for row in rows], np.float64) for name in ("latent_code", "range_m", "points")]
        return Pool(columns[0], columns[1], columns[2], rows)

    def nearest(self, code: Array) -> tuple[int, float]:
        """Return the index of the vehicle with the code nearest to `code` (d,), and the distance; ties give the first.

        Source: SHIFT3D, supplement, 'Retrieving the Nearest Match'.
        """
        distance = np.linalg.norm(self.codes - code, axis=1)
        index = int(np.argmin(distance))
        return index, float(distance[index])

    def controls(self, index: int, count: int) -> list[int]:
        """Return up to `count` other vehicles with similar range and number of points, the best match first.

        Source: our choice: the paper compares with the baseline alone, which no scene has shown.
        """
        # Not by logarithms: rounding would admit 30 points beside 20, but not 20 beside 30.
        far, more = (np.maximum(own / own[index], own[index] / own) for own in (self.range_m, self.points))
        matched = np.flatnonzero((far <= RANGE_RATIO) & (more <= POINTS_RATIO) & (np.arange(len(far)) != index))
        apart = np.log(far) / np.log(RANGE_RATIO) + np.log(more) / np.log(POINTS_RATIO)
        order = np.argsort(apart[matched], kind="stable")
        return [int(found) for found in matched[order[:count]]]


def excluded(code: Array, distance: float) -> bool:
    """True if the nearest vehicle is too far from a shape's code (d,): its distance is not below the code's length.

    Source: SHIFT3D, supplement: only objects with |z_natural - z| < |z| are considered.
    """
    return not distance < float(np.linalg.norm(code))
