"""Tables of measured settings: time and errors of each setting, and the meanings of the columns."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from shift3d.accuracy_time.pareto import MISPLACED_M, effective_error_m
from shift3d.analysis.tables.table import Table, factor, length, milliseconds, share
from shift3d.wording import counted


@dataclass(frozen=True)
class _Column:
    """Column of the tables: header, source column of the frame, cell format and meaning."""

    header: str
    source: str
    cell: Callable[[Any], str]
    meaning: str
    printed: bool = True  # False: only on the page, as a terminal has less room


_COLUMNS = (
    _Column("conditions", "conditions", str, "cold or warm start, SDF grid of the shape, gradient", False),
    _Column("time", "ms_median", milliseconds, "median time of one rendering"),
    _Column("from", "ms_low", milliseconds, "lower quartile of the time", False),
    _Column("to", "ms_high", milliseconds, "upper quartile of the time", False),
    _Column("x paper", "ratio_to_paper", factor, "times as fast as paper as published"),
    _Column("x chord", "ratio_to_paper_chord", factor, "times as fast as the setting 'paper, sphere chord only'"),
    _Column("evals", "evaluations_per_beam", factor, "decoder evaluations per beam through the object's sphere"),
    _Column("missed", "missed_hits", share, "hits that the setting did not find"),
    _Column("2 cm", "missed_hits_2cm", share, "missed, of the hits whose chord is at least 2 cm"),
    _Column("wrong", "wrong_surface", share, "hits on a surface other than the first"),
    _Column("false", "false_hits", share, "hits where the beam meets no surface"),
    _Column("p50", "depth_p50_m", length, "depth error of hits on the right surface, median"),
    _Column("p99", "depth_p99_m", length, "depth error of hits on the right surface, 99th percentile"),
    _Column("max", "depth_max_m", length, "depth error of hits on the right surface, maximum"),
    _Column("|g|", "residual_max_m", length, "largest distance of the field at a hit", False),
    _Column(
        "error", "error_m", length, f"bound on a beam's mean depth error; a misplaced beam counts {MISPLACED_M:g} m"
    ),
    _Column("cosine", "gradient_cosine", "{:.6f}".format, "cosine between the loss's gradient and that of reference"),
    _Column("norm", "gradient_norm_ratio", "{:.4f}".format, "norm of the gradient over that of reference", False),
    _Column("score", "score_delta", "{:.1e}".format, "mean absolute change of the final score", False),
    _Column("AUC", "auc_delta", "{:+.1e}".format, "change of the AUC"),
    _Column("attack", "attack_score", "{:.4f}".format, "mean score that short attacks on shape and pose reach"),
    _Column("detector", "detector_ms_median", milliseconds, "detector's forward and backward pass, median", False),
    _Column("step", "step_ms_median", milliseconds, "median time of a whole attack step"),
    _Column("step x", "step_ratio_to_paper", factor, "times as fast as the published step"),
    _Column("open", "unresolved_beams", "{:,}".format, "beams whose hit could not be decided", False),
    _Column("front", "pareto", lambda flag: "*" if flag else "", "on the Pareto front: no usable setting is better"),
)
RULE = (
    "A setting is dominated, and grey, if another setting on the same scenes takes no more time, has no larger error, "
    "and is better in time or error. A setting that needs a previous rendering (warm) or an SDF grid dominates only "
    "settings with the same need. A setting with a gradient is dominated only by settings with the same gradient. "
    "The error bounds the mean depth error of a beam: half of the median, plus 0.49 of the 99th percentile, plus 0.01 "
    f"of the maximum, plus {MISPLACED_M:g} m for every beam with a missed hit, a wrong surface or a false hit. The "
    "diagrams place an error of zero left of the dashed line."
)


def frontier_lines(frame: pd.DataFrame) -> str:
    """Format the printed tables and their legend, without columns for which a terminal has no room."""
    headers = measured_headers(frame, printed=True)
    tables = [str(table) for _, table in settings_tables(frame, headers)]
    return "\n\n".join([*tables, legend(meanings(headers))])


def measured_headers(frame: pd.DataFrame, printed: bool = False) -> list[str]:
    """Return the headers of columns with measurements. printed: only columns that fit on a terminal."""
    frame = _completed(frame)
    columns = [column for column in _COLUMNS if frame[column.source].notna().any()]
    return [column.header for column in columns if column.printed or not printed]


def settings_tables(frame: pd.DataFrame, headers: Collection[str]) -> list[tuple[str, Table]]:
    """Build the table of each scene set, fastest setting first. headers: columns to show."""
    found = []
    for scenes in dict.fromkeys(frame["scenes"]):
        rows = frame[frame["scenes"] == scenes].sort_values("ms_median", kind="stable")
        renders, beams = rows["renders"].max(), rows["beams"].max()
        looked = f"{counted(renders, 'rendering')}, {beams:,} beams"
        title = f"What accuracy costs on the {scenes} scenes ({looked}; * on the front)"
        found.append((str(scenes), settings_table(rows, title, str(scenes), headers)))
    return found


def settings_table(rows: pd.DataFrame, title: str, first: str, headers: Collection[str]) -> Table:
    """Build a table of rows in the given order. first: header of the setting names. headers: columns to show."""
    rows, columns = _completed(rows), [column for column in _COLUMNS if column.header in headers]
    lines = []
    for row in rows.iloc:
        cells = ["-" if pd.isna(row[column.source]) else column.cell(row[column.source]) for column in columns]
        lines.append([str(row["setting"]), *cells])
    kinds = [" ".join(["dominated"] * (not row["pareto"]) + ["ours"] * pd.notna(row["preset"])) for row in rows.iloc]
    return Table(title, [first, *(column.header for column in columns)], lines, kinds)


def meanings(headers: Collection[str]) -> dict[str, str]:
    """Return the meanings of columns by header."""
    return {column.header: column.meaning for column in _COLUMNS if column.header in headers}


def legend(terms: Mapping[str, str]) -> str:
    """Format the meanings of columns for the terminal."""
    return textwrap.fill("; ".join(f"{header}: {meaning}" for header, meaning in terms.items()), 120)


def _completed(frame: pd.DataFrame) -> pd.DataFrame:
    conditions = pd.Series([_conditions(row) for row in frame.iloc], index=frame.index, dtype=object)
    return frame.assign(error_m=effective_error_m(frame), conditions=conditions)


def _conditions(row: pd.Series) -> str | None:
    """Format the conditions, e.g. "warm, grid, pose gradient"; None if not recorded, as in a frontier of version 1."""
    if pd.isna(row["start"]):
        return None
    grid = ["grid"] if row["grid"] else []
    return ", ".join([row["start"], *grid, *([] if row["gradient"] == "no" else [f"{row['gradient']} gradient"])])
