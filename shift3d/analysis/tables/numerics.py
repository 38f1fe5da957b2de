"""How a sweep stood numerically, in a sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["diagnostics"]


def diagnostics(scores: pd.DataFrame) -> str:
    """How a sweep stood numerically, from the columns of its rows; each object counted once."""
    rows = scores[scores["max_residual_m"].notna()].drop_duplicates(["task_id", "method", "replicate"])
    if not len(rows):
        return "Numerics: no object was rendered."
    unresolved = int(rows["unresolved_beams"].sum())
    text = (
        f"Numerics: {int(scores['non_finite'].sum())} non-finite values, {unresolved} unresolved beams, largest |g| at "
        f"a hit {1e3 * float(rows['max_residual_m'].max()):.2g} mm over {counted(len(rows), 'object')}"
    )
    searched = rows[rows["method"] == "adversarial"]
    if searched["grazing_gradient"].notna().any():
        text += (
            f"; smallest |e.grad g| {float(rows['least_slope'].min()):.2g}, grazing beams carry "
            f"{float(searched['grazing_gradient'].mean()):.0%} of the gradient"
        )
    return f"{text}."
