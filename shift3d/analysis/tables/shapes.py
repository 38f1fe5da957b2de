"""How many adversarial shapes are natural, by lambda."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.analysis.results import natural_by_task
from shift3d.analysis.tables.table import Table, number
from shift3d.analysis.variants import aucs_of_scores
from shift3d.naturalness.calibration import NATURAL_RULE

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["natural_table"]


def natural_table(scores: pd.DataFrame) -> Table | None:
    """Count, AUC and its ratio to the baseline's over all adversarial shapes and over the natural ones.

    A line an attacked detector, alpha and lambda, chosen or not. Means are those of the vehicles' AUCs. scores: of
    ``final/``. None where nothing was measured.
    """
    verdicts = natural_by_task(scores)
    own = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    own = own[own["method"].isin(["baseline", "adversarial"]) & own["task_id"].isin(verdicts)]
    rows = own[own.groupby("task_id")["method"].transform("nunique") == 2] if len(own) else own
    if rows.empty:
        return None
    rows = rows.assign(natural=rows["task_id"].map(verdicts))
    lines = []
    for (detector, alpha, weight), group in rows.groupby(["detector", "alpha", "lambda"], sort=False, dropna=False):
        natural = group[group["natural"]]
        counts = [part["task_id"].nunique() for part in (natural, group)]
        line = [f"{detector}, alpha {alpha:g}, lambda {weight:g}", f"{counts[0]} of {counts[1]}"]
        for part in (group, natural):
            aucs, vehicles = aucs_of_scores(part), list(dict.fromkeys(part["vehicle"]))
            line += [number(aucs.mean(method, vehicles)) for method in ("baseline", "adversarial")]
            line.append(number(aucs.of_baseline("adversarial", vehicles), 2))
        lines.append(line)
    header = ["", "natural", "baseline", "adversarial", "ratio", "natural: baseline", "adversarial", "ratio"]
    return Table(f"Natural adversarial shapes ({NATURAL_RULE})", header, lines)
