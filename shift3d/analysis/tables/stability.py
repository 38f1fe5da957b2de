"""Stability and robustness of solutions by method, as printed text and table."""

from __future__ import annotations

import math

import pandas as pd

from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import differing_settings
from shift3d.methods import METHODS
from shift3d.wording import counted

MEANINGS = {
    "verified": "number of solutions that were scored again",
    "unstable": "of these, score or margin to the baseline differs by more than 0.02 from reference accuracy (float64)",
    "stable": "share of the verified solutions that are not unstable",
    "|score - ref|": "largest difference between a score and the score at reference accuracy",
    "again": "share whose score, computed again at the sweep's accuracy, is the same bit for bit",
    "robust": "share that keeps at least half of its margin, or loses at most 0.02, in every draw of noise (2 cm along "
    "the beams on the object) and of a pose offset (1 cm, 0.1 degrees); the baseline gets the same draws",
}
_GROUP = ["method", "mode", "lambda", "scored_by", "settings"]


def stability_lines(verification: pd.DataFrame) -> str:
    """Format the printed table, with unstable solutions and causes. verification: see `stability_table`."""
    parts = [str(stability_table(verification))]
    if unstable := unstable_lines(verification, shown=10):
        count = int((~verification["stable"]).sum())
        parts.append("\n".join([counted(count, "unstable solution"), *(f"  {line}" for line in unstable)]))
    return "\n\n".join(parts)


def stability_table(verification: pd.DataFrame) -> Table:
    """Build the table of verified solutions by method, mode, lambda, scoring detector and other differing settings.

    verification: the table of ``final/``, with `with_effects_requested` if effects may differ.
    """
    verification = verification.explode("effects") if "effects" in verification else verification
    alpha = [f"alpha {value:g}" for value in verification["alpha"]]
    names = ("search", "alpha", "detector", "accuracy", "effects")
    settings = differing_settings(verification.assign(alpha=alpha), names)
    lines = []
    for key, rows in verification.assign(settings=settings).groupby(_GROUP, sort=False, dropna=False):
        method, mode, weight, scored_by, other = key
        unstable = int((~rows["stable"]).sum())
        difference = (rows["score"] - rows["score_reference"]).abs().max()
        again = (rows["score"] == rows["score_again"]).mean()
        shares = f"{1 - unstable / len(rows):.1%}", f"{difference:.1e}", f"{again:.0%}", f"{rows['robust'].mean():.0%}"
        name = ", ".join(filter(None, [METHODS.get(method, method), other]))
        group = [name, mode, "-" if math.isnan(weight) else f"{weight:g}", scored_by]
        lines.append([*group, str(len(rows)), str(unstable), *shares])
    header = ["method", "mode", "lambda", "scored by", *MEANINGS]
    return Table("Scored again at reference accuracy", header, lines)


def unstable_lines(verification: pd.DataFrame, shown: int | None = None) -> list[str]:
    """Describe unstable solutions and causes, one line each. shown: maximum number of lines; the rest is counted."""
    unstable = verification[~verification["stable"]]
    lines = [
        f"{row.task_id}  {row.vehicle} {row.scene} {row.method} {row.replicate}: {row.score:.3f}, "
        f"reference {row.score_reference:.3f}; {row.cause}"
        for row in unstable.head(len(unstable) if shown is None else shown).itertuples()
    ]
    left = len(unstable) - len(lines)
    return [*lines, f"and {left} more in verification.parquet"] if left else lines
