"""How many adversarial shapes are plausible as cars, by lambda."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.analysis.tables.table import Table, number
from shift3d.analysis.variants import aucs_of_scores
from shift3d.vehicles.outline import CAR_RULE

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["plausible_table"]


def plausible_table(scores: pd.DataFrame, shapes: pd.DataFrame) -> Table | None:
    """Count, AUC and its ratio to the baseline's over all adversarial shapes and over the plausible ones.

    A line an attacked detector, alpha and lambda, chosen or not. Means are those of the vehicles' AUCs. scores, shapes:
    tables of ``final/``. None where nothing was measured.
    """
    measured = shapes[shapes["still_a_car"].notna()]
    own = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    own = own[own["method"].isin(["baseline", "adversarial"])][["task_id", "method", "score"]]
    both = set(own.loc[own["method"] == "baseline", "task_id"]) & set(
        own.loc[own["method"] == "adversarial", "task_id"]
    )
    own, measured = (part[part["task_id"].isin(both)] for part in (own, measured))
    if measured.empty:
        return None
    rows = measured.drop(columns="method", errors="ignore").merge(own, on="task_id")
    lines = []
    for (detector, alpha, weight), group in rows.groupby(["detector", "alpha", "lambda"], sort=False, dropna=False):
        plausible = group[group["still_a_car"].eq(True)]
        counts = [part["task_id"].nunique() for part in (plausible, group)]
        line = [f"{detector}, alpha {alpha:g}, lambda {weight:g}", f"{counts[0]} of {counts[1]}"]
        for part in (group, plausible):
            aucs, vehicles = aucs_of_scores(part), list(dict.fromkeys(part["vehicle"]))
            line += [number(aucs.mean(method, vehicles)) for method in ("baseline", "adversarial")]
            line.append(number(aucs.of_baseline("adversarial", vehicles), 2))
        lines.append(line)
    header = ["", "plausible", "baseline", "adversarial", "ratio", "plausible: baseline", "adversarial", "ratio"]
    return Table(f"Plausible adversarial shapes ({CAR_RULE})", header, lines)
