"""Bird's-eye-view grids: score reduction by the cell of the vehicle."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from shift3d.evaluation.bev_grid import CELL_SIZE_M, bev_grid
from shift3d.store.schemas import GROUP_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

_SHOWN_M = 50.0


def groups(frame: pd.DataFrame) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Return the groups in order of first appearance; a missing lambda (pose) counts as a value."""
    grouped = frame.groupby(list(GROUP_COLUMNS), sort=False, dropna=False)
    return [
        ({name: None if value != value else value for name, value in zip(GROUP_COLUMNS, key)}, rows)
        for key, rows in grouped
    ]


def bev_rows(scored: pd.DataFrame) -> list[dict[str, Any]]:
    """Compute the score reduction against the same task's baseline, by the cell of the vehicle's first place.

    A pose attack moves the vehicle; its cell stays that of the baseline (our choice: the paper's grid is for shapes).
    """
    keys = ["task_id", "effects", "scored_by"]
    baseline = scored[scored["method"] == "baseline"].drop_duplicates(keys)[[*keys, "score", "x_m", "y_m"]]
    pairs = scored[scored["method"] != "baseline"].merge(baseline, on=keys, suffixes=("", "_baseline"))
    rows: list[dict[str, Any]] = []
    for group, members in groups(pairs):
        xy = members[["x_m_baseline", "y_m_baseline"]].to_numpy()
        rows += [group | cell for cell in _cells(xy, members["score_baseline"], members["score"])]
    return rows


def transfer_rows(transfers: pd.DataFrame, reach_m: float) -> list[dict[str, Any]]:
    """Compute the score reduction of every shape in other scenes, by the cell of its place there.

    transfers: rows of the table; those without a score are ignored. reach_m: half side of the square whose empty cells
    are rows too, limited to the farthest vehicle or to 50 m, if that is more. Source: SHIFT3D fig. bev_score.
    """
    placed = transfers[transfers["score"].notna()].assign(method="adversarial")
    reached_m = float(placed[["x_m", "y_m"]].abs().to_numpy().max(initial=0.0))
    reach_m = min(reach_m, max(_SHOWN_M, reached_m))
    ends = [CELL_SIZE_M * cell for cell in range(-math.ceil(reach_m / CELL_SIZE_M), math.ceil(reach_m / CELL_SIZE_M))]
    rows: list[dict[str, Any]] = []
    for group, members in groups(placed):
        xy = members[["x_m", "y_m"]].to_numpy()
        filled = list(_cells(xy, members["score_baseline"], members["score"]))
        found = {(cell["cell_x_m"], cell["cell_y_m"]): cell for cell in filled}
        everywhere = sorted({*found, *itertools.product(ends, ends)})
        rows += [group | (found.get(corner) or _empty(corner)) for corner in everywhere]
    return rows


def _cells(xy: Any, before: Any, after: Any) -> Iterator[dict[str, Any]]:
    grid = bev_grid(xy, before, after)
    for i, corner in enumerate(grid.corner_xy_m.tolist()):
        cell = {"cell_x_m": corner[0], "cell_y_m": corner[1], "cell_size_m": CELL_SIZE_M}
        values = {"scores": grid.count[i], "mean_score_baseline": grid.mean_before[i]}
        yield cell | values | {"mean_score": grid.mean_after[i], "mean_reduction": grid.mean_reduction[i]}


def _empty(corner: tuple[float, float]) -> dict[str, Any]:
    cell = {"cell_x_m": corner[0], "cell_y_m": corner[1], "cell_size_m": CELL_SIZE_M, "scores": 0}
    return cell | {"mean_score_baseline": None, "mean_score": None, "mean_reduction": None}
