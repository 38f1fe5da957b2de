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
    _Column(
        "conditions", "conditions", str, "cold or warm, with an SDF grid of the shape, ready for a gradient", False
    ),
    _Column("time", "ms_median", milliseconds, "of one rendering, median"),
    _Column("from", "ms_low", milliseconds, "lower quartile of the time", False),
    _Column("to", "ms_high", milliseconds, "upper quartile of the time", False),
    _Column("x paper", "ratio_to_paper", factor, "times as fast as paper as published"),
    _Column("x chord", "ratio_to_paper_chord", factor, "times as fast as paper, sphere chord only"),
    _Column("evals", "evaluations_per_beam", factor, "decoder evaluations a beam through the object's ball"),
    _Column("missed", "missed_hits", share, "hits that were not found"),
    _Column("2 cm", "missed_hits_2cm", share, "the same, of the hits whose chord is at least 2 cm"),
    _Column("wrong", "wrong_surface", share, "hits on a surface that is not the first"),
    _Column("false", "false_hits", share, "hits where there is none"),
    _Column("p50", "depth_p50_m", length, "depth error of hits on the right surface, median"),
    _Column("p99", "depth_p99_m", length, "depth error of hits on the right surface, 99th percentile"),
    _Column("max", "depth_max_m", length, "depth error of hits on the right surface, maximum"),
    _Column("|g|", "residual_max_m", length, "largest distance of the field at a hit", False),
    _Column(
        "error", "error_m", length, f"bound on a beam's mean depth error; a misplaced beam counts {MISPLACED_M:g} m"
    ),
    _Column("cosine", "gradient_cosine", "{:.6f}".format, "of the loss's gradient with that of reference"),
    _Column("norm", "gradient_norm_ratio", "{:.4f}".format, "length of that gradient over that of reference", False),
    _Column("score", "score_delta", "{:.1e}".format, "mean change of the final score, without sign", False),
    _Column("AUC", "auc_delta", "{:+.1e}".format, "change of the AUC"),
    _Column("attack", "attack_score", "{:.4f}".format, "mean score that short attacks on shape and pose reach"),
    _Column("detector", "detector_ms_median", milliseconds, "forward and backward, median", False),
    _Column("step", "step_ms_median", milliseconds, "a whole attack step, median"),
    _Column("step x", "step_ratio_to_paper", factor, "times as fast as the published step"),
    _Column("open", "unresolved_beams", "{:,}".format, "beams that could not be decided", False),
    _Column("front", "pareto", lambda flag: "*" if flag else "", "no setting that could be used instead is better"),
)
RULE = (
    "A setting is dominated, and grey, where another one on the same scenes takes no more time, has no larger error, "
    "and is better in one of the two. A setting that needs a previous rendering (warm) or an SDF grid dominates only "
    "such as have it, too, and what is ready for a gradient is dominated only by what is ready for the same. "
    f"The error is a bound on the mean error of a beam's depth: half of the median, 0.49 of the 99th percentile, 0.01 "
    f"of the maximum, and {MISPLACED_M:g} m for every beam that missed, hit a wrong surface, or hit nothing that is "
    "there. On the diagrams an error of zero has its place left of the dashed line."
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
