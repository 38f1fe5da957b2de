"""Are the hard cases hard, or rounding? What is printed of it, and the page."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

import numpy as np

from shift3d.report.numerics import diagnostics
from shift3d.report.page import html_image, html_table, page
from shift3d.report.tables import aligned
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["stability_figure", "stability_lines", "write_stability_page"]

_GROUP = ["mode", "lambda", "scored_by", "method"]
_HEADER = [
    "mode",
    "lambda",
    "scored by",
    "method",
    "verified",
    "unstable",
    "stable",
    "|score - ref|",
    "again",
    "robust",
]
_MEANINGS = (
    ("verified", "solutions that were scored again"),
    ("unstable", "of these, score or margin to the baseline more than 0.02 from that at reference accuracy"),
    ("stable", "share of the others"),
    ("|score - ref|", "largest difference of a score from that at reference accuracy"),
    ("again", "scored again at the sweep's accuracy, the share that came out the same bit for bit"),
    ("robust", "share that keeps at least half of its margin under noise of 2 cm along the beams on the object, and a "
     "little off its pose (1 cm, 0.1 degrees), in every draw; the baseline gets the same draws"),
)  # fmt: skip
_SHOWN = 10
# Of Okabe and Ito: told apart by who does not see all colours.
_COLOURS = {"baseline": "#000000", "random": "#56b4e9", "adversarial_noise": "#e69f00", "adversarial": "#d55e00"}


def stability_lines(verification: pd.DataFrame) -> str:
    """The printed table, and what was unstable and why. verification: the table of ``final/``."""
    parts = [aligned("Scored again at reference accuracy", _HEADER, _lines(verification))]
    unstable = verification[~verification["stable"]]
    if len(unstable):
        shown = [f"  {_unstable_line(row)}" for row in unstable.head(_SHOWN).to_dict("records")]
        more = [f"  and {len(unstable) - _SHOWN} more in verification.parquet"] if len(unstable) > _SHOWN else []
        parts.append("\n".join([f"{len(unstable)} unstable", *shown, *more]))
    return "\n\n".join(parts)


def _lines(verification: pd.DataFrame) -> list[list[str]]:
    lines = []
    for key, rows in verification.groupby(_GROUP, sort=False, dropna=False):
        mode, lambda_, scored_by, method = key
        group = [mode, "-" if np.isnan(lambda_) else f"{lambda_:g}", scored_by, method.replace("_", " + ")]
        unstable = int((~rows["stable"]).sum())
        difference = (rows["score"] - rows["score_reference"]).abs().max()
        again = (rows["score"] == rows["score_again"]).mean()
        shares = f"{1 - unstable / len(rows):.1%}", f"{difference:.1e}", f"{again:.0%}", f"{rows['robust'].mean():.0%}"
        lines.append([*group, str(len(rows)), str(unstable), *shares])
    return lines


def _unstable_line(row: dict[str, object]) -> str:
    return (
        f"{row['task_id']}  {row['vehicle']} {row['scene']} {row['method']} {row['replicate']}: {row['score']:.3f}, "
        f"reference {row['score_reference']:.3f}; {row['cause']}"
    )


def write_stability_page(path: LocationLike, sweep: str, scores: pd.DataFrame, verification: pd.DataFrame) -> Location:
    """Write the page of one sweep's stability: self-contained, the same tables to the same bytes.

    Raises:
        InputError: the disk is full or not writable.
    """
    unstable = verification[~verification["stable"]].to_dict("records")
    listed = "".join(f"<li>{html.escape(_unstable_line(row))}</li>" for row in unstable)
    meanings = "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>" for name, text in _MEANINGS)
    body = [
        f"<p>{html.escape(diagnostics(scores))}</p>",
        html_image(
            stability_figure(verification),
            "Left: each solution's score at reference accuracy against the score that the sweep reported; right: how "
            "much of its margin to the baseline is left under noise and off its pose",
        ),
        "<h2>Scored again at reference accuracy</h2>",
        html_table(_HEADER, _lines(verification)),
        f"<h2>{len(unstable)} unstable</h2>",
        f"<ul>{listed}</ul>" if unstable else "<p>None.</p>",
        "<h2>What the numbers mean</h2>",
        f"<dl>{meanings}</dl>",
    ]
    location = as_location(path)
    location.write_atomic(page(f"Stability of {sweep}", body).encode())
    return location


def stability_figure(verification: pd.DataFrame) -> Figure:
    """Scores against those of the reference, and margins against the least margin of the draws."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.6), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for method, colour in _COLOURS.items():
        rows = verification[verification["method"] == method]
        if not len(rows):
            continue
        style = {"s": 12, "alpha": 0.6, "color": colour, "label": method.replace("_", " + ")}
        left.scatter(rows["score"], rows["score_reference"], **style)
        if method != "baseline":
            least = rows[["least_margin_noise", "least_margin_nearby"]].min(axis=1)
            right.scatter(rows["margin"], least, **style)
    left.plot([0, 1], [0, 1], color="0.6", linewidth=0.8, zorder=0)
    left.set(xlabel="score, as reported", ylabel="score at reference accuracy", xlim=(0, 1), ylim=(0, 1))
    right.axline((0, 0), slope=1, color="0.6", linewidth=0.8, zorder=0)
    right.axline((0, 0), slope=0.5, color="0.6", linewidth=0.8, linestyle="--", zorder=0)
    right.set(xlabel="baseline's score minus the solution's", ylabel="least of it under noise and off the pose")
    for axes in (left, right):
        axes.legend(frameon=False)
    return figure
