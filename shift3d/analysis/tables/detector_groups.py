"""The printed tables of a detector's quality over all vehicles and by group, with intervals."""

from __future__ import annotations

from collections.abc import Sequence

from shift3d.analysis.tables.table import Table, number
from shift3d.evaluation.breakdown import BreakdownRow

__all__ = ["group_table", "summary_table"]

_MEASURES = (
    ("AP", "BEV", "BEV AP"),
    ("APH", "BEV", "BEV APH"),
    ("AP", "3D", "3D AP"),
    ("APH", "3D", "3D APH"),
    ("recall", "BEV 0.7", "recall, BEV"),
    ("recall", "3D 0.7", "recall, 3D"),
    ("flips", "share", "flipped"),
)
_ERRORS = {
    "x_m": "along, m",
    "y_m": "across, m",
    "z_m": "height of centre, m",
    "dx_m": "length, m",
    "dy_m": "width, m",
    "dz_m": "height, m",
    "heading_rad": "heading, rad",
}


def summary_table(title: str, rows: Sequence[BreakdownRow]) -> Table:
    """Over all vehicles of LEVEL_1 within 75 m, IoU 0.7: AP, APH, recall, flips, and errors, with 95 % intervals."""
    known = {(row.measure, row.statistic): row for row in rows if row.by == "all"}
    lines = []
    for measure, statistic, name in _MEASURES:
        row = known[measure, statistic]
        lines.append([name, number(row.value), _interval(row), "", "", str(row.number)])
    for error, name in _ERRORS.items():
        mean, middle, spread = (known[f"error_{error}", statistic] for statistic in ("mean", "median", "std"))
        others = [number(middle.value), number(spread.value), str(mean.number)]
        lines.append([name, number(mean.value), _interval(mean), *others])
    note = "LEVEL_1, 0-75 m, IoU 0.7; errors are means, found less true; intervals: 95 %, scenes resampled"
    return Table(f"{title}\n{note}", ["", "value", "interval", "median", "std", "number"], lines)


def group_table(rows: Sequence[BreakdownRow]) -> Table:
    """A line a group: by range, heading, number of points, and kind of vehicle where labels carry one."""
    known = {(row.by, row.group, row.measure, row.statistic): row for row in rows}
    lines = []
    for by, group in dict.fromkeys((row.by, row.group) for row in rows if row.by != "all"):
        line = [f"{by}: {group}", str(known[by, group, "AP", "BEV"].number)]
        for view in ("BEV", "3D"):
            row = known[by, group, "AP", view]
            line += [number(row.value), _interval(row)]
        others = (("recall", "BEV 0.7"), ("flips", "share"), *((f"error_{e}", "mean") for e in ("z_m", "dx_m", "dz_m")))
        lines.append([*line, *(number(known[by, group, *key].value) for key in others)])
    header = ["", "number", "BEV AP", "interval", "3D AP", "interval", "recall", "flipped"]
    return Table("By group, as above", [*header, "z m", "length m", "height m"], lines)


def _interval(row: BreakdownRow) -> str:
    return "-" if row.low is None or row.high is None else f"{row.low:.3f} to {row.high:.3f}"
