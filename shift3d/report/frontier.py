"""What people read of a measured frontier: the printed table, the page, the picture and the advice."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from shift3d.accuracy_time.pareto import MISPLACED_M, effective_error_m
from shift3d.errors import InputError
from shift3d.report.frontier_advice import advice
from shift3d.report.frontier_figure import work_precision_figure
from shift3d.report.numbers import factor, length, milliseconds, share
from shift3d.report.page import html_image, html_table, page, png
from shift3d.report.tables import aligned
from shift3d.store.atomic import write_atomic
from shift3d.store.frontier_table import machine_of, read_frontier

__all__ = ["advice", "frontier_html", "frontier_lines", "work_precision_figure", "write_report"]


@dataclass(frozen=True)
class _Column:
    """A column of the tables: of which column of the frame, as what, and what it means."""

    header: str
    source: str
    cell: Callable[[Any], str]
    meaning: str
    printed: bool = True  # on the terminal too, which has less room than the page


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
    _Column("p99", "depth_p99_m", length, "the same, 99th percentile"),
    _Column("max", "depth_max_m", length, "the same, maximum"),
    _Column("|g|", "residual_max_m", length, "largest distance of the field at a hit", False),
    _Column("error", "error_m", length, f"all in one, see below; a beam misplaced counts {MISPLACED_M:g} m"),
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
_RULE = (
    "A setting is dominated, and grey, where another one on the same scenes takes no more time, has no larger error, "
    "and is better in one of the two. A setting that needs a previous rendering (warm) or an SDF grid dominates only "
    "such as have it, too, and what is ready for a gradient is dominated only by what is ready for the same. "
    f"The error is a bound on the mean error of a beam's depth: half of the median, 0.49 of the 99th percentile, 0.01 "
    f"of the maximum, and {MISPLACED_M:g} m for every beam that missed, hit a wrong surface, or hit nothing that is "
    "there. On the diagrams an error of zero has its place left of the dashed line."
)


def frontier_lines(frame: pd.DataFrame) -> str:
    """The printed table: a block a scene set, the fastest setting first.

    Columns for which nothing was measured are left out, and some that only the page and the Parquet file show.

    Args:
        frame: the frontier's table.
    """
    blocks = []
    for scenes, rows, columns in _sets(frame):
        columns = [column for column in columns if column.printed]
        renders, beams = rows["renders"].max(), rows["beams"].max()
        title = f"What accuracy costs on the {scenes} scenes ({renders:,} renderings, {beams:,} beams; * on the front)"
        header = [scenes, *(column.header for column in columns)]
        blocks.append(aligned(title, header, [[str(row["setting"]), *_cells(row, columns)] for row in rows.iloc]))
    return "\n\n".join(blocks)


def _sets(frame: pd.DataFrame) -> list[tuple[str, pd.DataFrame, list[_Column]]]:
    frame = frame.assign(error_m=effective_error_m(frame), conditions=[_conditions(row) for row in frame.iloc])
    columns = [column for column in _COLUMNS if frame[column.source].notna().any()]
    return [
        (str(scenes), frame[frame["scenes"] == scenes].sort_values("ms_median", kind="stable"), columns)
        for scenes in dict.fromkeys(frame["scenes"])
    ]


def _conditions(row: pd.Series) -> str | None:
    """ "warm, grid, pose gradient"; None where they were not recorded, as in a frontier of version 1."""
    if pd.isna(row["start"]):
        return None
    grid = ["grid"] if row["grid"] else []
    return ", ".join([row["start"], *grid, *([] if row["gradient"] == "no" else [f"{row['gradient']} gradient"])])


def _cells(row: pd.Series, columns: list[_Column]) -> list[str]:
    return ["-" if pd.isna(row[column.source]) else column.cell(row[column.source]) for column in columns]


def frontier_html(frame: pd.DataFrame, machine: Mapping[str, Any]) -> str:
    """A page that needs nothing but itself: diagrams, advice, the table and what its columns mean.

    Args:
        frame: the frontier's table.
        machine: what it was measured on, by name.
    """
    told = advice(frame).split("\n\n")
    measured = ", ".join(f"{name} {value}" for name, value in machine.items()) or "not recorded"
    parts = [f"<p>Measured on: {html.escape(measured)}.</p>"]
    for (scenes, rows, columns), paragraph in zip(_sets(frame), told):
        parts += [
            f"<h2>{html.escape(scenes)}</h2>",
            f"<p>{html.escape(paragraph)}</p>",
            html_image(work_precision_figure(frame, scenes), f"Time of a rendering against its error, {scenes} scenes"),
            _html_table(rows, columns),
        ]
    meanings = "".join(
        f"<dt>{html.escape(column.header)}</dt><dd>{html.escape(column.meaning)}</dd>" for column in _sets(frame)[0][2]
    )
    parts += ["<h2>What the numbers mean</h2>", f"<p>{html.escape(_RULE)}</p>", f"<dl>{meanings}</dl>"]
    return page("What accuracy costs in time", parts)


def _html_table(rows: pd.DataFrame, columns: list[_Column]) -> str:
    kinds = [
        (("" if row["pareto"] else "dominated ") + ("preset" if pd.notna(row["preset"]) else "")).strip()
        for row in rows.iloc
    ]
    lines = [[str(row["setting"]), *_cells(row, columns)] for row in rows.iloc]
    return html_table(["setting", *(column.header for column in columns)], lines, kinds)


def write_report(folder: Path) -> str:
    """Write report.html, frontier.png and advice.txt beside folder/frontier.parquet, each whole or not at all.

    The same table gives the same bytes. The report can be written again from the table alone.

    Returns:
        What is printed: the table and the advice.

    Raises:
        InputError: no frontier there, or not one of this version; a disk that is full or not writable.
    """
    table = read_frontier(folder / "frontier.parquet")
    if not table.num_rows:
        raise InputError("holds no setting", str(folder / "frontier.parquet"), "Run make frontier again")
    frame = table.to_pandas()
    told = advice(frame)
    write_atomic(folder / "advice.txt", f"{told}\n".encode())
    write_atomic(folder / "frontier.png", png(work_precision_figure(frame)))
    write_atomic(folder / "report.html", frontier_html(frame, machine_of(table)).encode())
    return f"{frontier_lines(frame)}\n\n{told}"
