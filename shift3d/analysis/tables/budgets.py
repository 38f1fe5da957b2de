"""AUC as a function of the naturalness budget: how hard vehicles become that remain plausible vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from shift3d.analysis.statistics.intervals import Interval, ratio_interval
from shift3d.analysis.statistics.paired import paired
from shift3d.analysis.tables.auc import with_baseline
from shift3d.analysis.tables.table import Table, interval_text, number
from shift3d.analysis.variants import Variant
from shift3d.task.spec import label_words, split_label

ANY_SHAPE = math.inf  # Budget of a search without a limit; percentile 100 still bounds sizes.


def budget_text(budget: float) -> str:
    """Format a budget: "95", or "any shape"."""
    return "any shape" if budget == ANY_SHAPE else f"{budget:g}"


@dataclass(frozen=True)
class BudgetCurve:
    """One search against one detector under several budgets. variants: by percentile limit of the shapes, ascending."""

    title: str
    variants: dict[float, Variant]

    def ratio(self, budget: float, method: str) -> Interval | None:
        """Compute the method's AUC over the baseline's for the same tasks, scenes redrawn; None without scores."""
        return ratio_interval(*with_baseline(self.variants[budget].rows, method))


def budget_curves(found: Sequence[Variant]) -> list[BudgetCurve]:
    """Collect the shape searches that a sweep ran under two or more budgets."""
    groups: dict[tuple[str, ...], dict[float, Variant]] = {}
    for variant in found:
        search, budget = split_label(variant.search)
        settings = (variant.detector, variant.scored_by, f"alpha {variant.alpha:g}", variant.accuracy, variant.effects)
        if variant.mode != "pose" and len(variant.auc):
            groups.setdefault((variant.mode, search, *settings), {})[budget or ANY_SHAPE] = variant
    several = {key: dict(sorted(group.items())) for key, group in groups.items() if len(group) > 1}
    differing = [len(set(values)) > 1 for values in zip(*several)]
    differing[:2] = [True] * len(differing[:2])  # mode and search are always part of the title
    return [
        BudgetCurve(", ".join(label_words(text) for text, differs in zip(key, differing) if differs), group)
        for key, group in several.items()
    ]


def budget_table(found: Sequence[Variant]) -> Table | None:
    """Build the table: one line per search and budget, over all scored tasks; None if no search has two budgets."""
    lines = []
    for curve in budget_curves(found):
        for budget, variant in curve.variants.items():
            ratios = [interval_text(curve.ratio(budget, method), 2, "") for method in ("random_budget", "adversarial")]
            gain = paired(variant.rows, "adversarial", "random_budget")
            difference = interval_text(None if gain is None else gain.interval, 3)
            means = [number(variant.aucs.mean(name, variant.vehicles)) for name in ("baseline", "adversarial")]
            lines.append([f"{curve.title}, {budget_text(budget)}", *_shapes(variant.rows), *means, *ratios, difference])
    header = ["search, percentile", "natural", "cm", "baseline", "adversarial", "of baseline, random draws",
              "of baseline", "less random draws"]  # fmt: skip
    title = "AUC by naturalness budget; cm: median distance to the nearest known vehicle"
    return Table(title, header, lines) if lines else None


def _shapes(rows: pd.DataFrame) -> list[str]:
    """Format the number of natural adversarial shapes, and their median surface distance in cm."""
    own = rows[rows["method"] == "adversarial"].drop_duplicates("task_id")
    judged = own[own["natural"].notna()]
    natural = f"{int(judged['natural'].eq(True).sum())} of {len(judged)}" if len(judged) else "-"
    return [natural, number(judged["surface_distance_cm"].median() if "surface_distance_cm" in own else None, 1)]
