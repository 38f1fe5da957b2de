"""What shapes do in scenes that they were not searched in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.analysis.statistics.intervals import mean_interval, ratio_interval
from shift3d.analysis.tables.table import Table, number

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["transfer_table"]

_GROUP = ["search", "lambda", "alpha", "detector", "scored_by"]


def transfer_table(transfers: pd.DataFrame) -> Table | None:
    """A line a search and scoring detector: placements, AUC before and after, and their ratio with its interval.

    transfers: of ``final/``. Means are those of the vehicles' means; intervals redraw whole scenes. A placement on
    which the shape breaks a constraint counts as any other. None where nothing was put into another scene.
    """
    placed = transfers[transfers["score"].notna()]
    if placed.empty:
        return None
    placed = placed.assign(place=placed["dataset"] + "/" + placed["other_scene"])
    lines = []
    for (search, weight, alpha, detector, scored_by), rows in placed.groupby(_GROUP, sort=False, dropna=False):
        before = rows.assign(score=rows["score_baseline"])
        after, fell = _vehicle_mean(rows), mean_interval(rows["score"] < rows["score_baseline"], list(rows["place"]))
        ratio = ratio_interval(rows, before)
        interval = "-" if ratio is None else f"{ratio.mean:.2f} [{number(ratio.low, 2)}, {number(ratio.high, 2)}]"
        name = f"{search}, lambda {weight:g}, alpha {alpha:g}, {detector}"
        counts = [str(len(rows)), str(rows["other_scene"].nunique())]
        means = [number(_vehicle_mean(before)), number(after)]
        lines.append([name, scored_by, *counts, *means, interval, f"{fell.mean:.0%}"])
    header = ["", "scored by", "placements", "scenes", "baseline", "shape", "ratio", "lower in"]
    return Table("The shapes in scenes that they were not searched in", header, lines)


def _vehicle_mean(rows: pd.DataFrame) -> float:
    return float(rows.groupby("vehicle")["score"].mean().mean())
