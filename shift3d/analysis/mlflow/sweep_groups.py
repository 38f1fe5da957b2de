"""Content of a sweep's MLflow runs: one row per group of its AUC table, and recall at thresholds in steps of 1 %."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from shift3d.analysis.mlflow.client import metric_name
from shift3d.analysis.tables.budgets import budget_curves
from shift3d.analysis.variants import SETTINGS, setting_text, variants

MOST_GROUPS = 200  # Maximum number of groups with a run; MLflow's lists are unreadable beyond it.

_KEY = ("mode", "vehicle", "method")
_VARIANTS = ("dataset", "lambda", *SETTINGS)
_NUMBERS = ("auc", "scores", "tasks_scored", "tasks_planned", "mean_adversarial_loss", "mean_latent_distance")
_PERCENT = np.arange(101) / 100.0

Recall = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """One row of the AUC table. name: mode, vehicle, method, and everything else that differs within the sweep. params:
    all keys of the group by name. metrics: its existing numbers. recall: (101,) at score thresholds of 0, 1, ... 100 %,
    or None."""

    name: str
    params: Mapping[str, str]
    metrics: Mapping[str, float]
    recall: Recall | None


def groups(auc: pd.DataFrame, curves: pd.DataFrame) -> list[Group]:
    """Select at most MOST_GROUPS groups, those of the chosen lambda first. auc, curves: tables of ``final/``."""
    recalls = _recalls(curves)
    several = [name for name in _VARIANTS if auc[name].nunique(dropna=False) > 1]
    shown = auc.sort_values("selected", ascending=False, kind="stable").head(MOST_GROUPS)
    return [
        Group(
            name="/".join([*(_text(row[name]) for name in _KEY), *(f"{name}={_text(row[name])}" for name in several)]),
            params={name: _text(row[name]) for name in (*_KEY, *_VARIANTS, "selected")},
            metrics={name: float(row[name]) for name in _NUMBERS if row[name] == row[name] and row[name] is not None},
            recall=recalls.get(_identity(row)),
        )
        for row in shown.to_dict("records")
    ]


def overall_metrics(auc: pd.DataFrame, curves: pd.DataFrame) -> tuple[dict[str, float], dict[str, Recall]]:
    """Compute AUCs by vehicle, their means over vehicles, and mean recall curves, all for the chosen lambda.

    Returns: ``auc/shape/coupe/adversarial`` and, for the mean, ``shape/adversarial`` to a number (short names, because
    a column of MLflow's list shows about twelve letters); ``recall/shape/adversarial`` to (101,), the mean over
    vehicles. Settings that differ within the sweep follow the method. A score of the attacked detector itself has no
    name of a scoring detector, so that a sweep with one scoring detector has the same name for it.
    """
    recalls = _recalls(curves)
    values: dict[str, float] = {}
    mean_recalls: dict[str, Recall] = {}
    for variant in variants(auc):
        implied = ("scored_by",) if variant.scores_itself else ()
        settings = [text for name, text in variant.differing.items() if name not in implied]
        for method in variant.methods:
            tail = "/".join([method, *settings])
            found = {f"auc/{variant.mode}/{name}/{tail}": variant.aucs.of(method, name) for name in variant.vehicles}
            found[f"{variant.mode}/{tail}"] = variant.aucs.mean(method, variant.vehicles)
            values |= {metric_name(name): value for name, value in found.items() if value is not None}
            rows = variant.auc[variant.auc["method"] == method]
            means = [mean for _, group in rows.groupby("vehicle") if (mean := _mean(group, recalls)) is not None]
            if means:
                mean_recalls[metric_name(f"recall/{variant.mode}/{tail}")] = np.mean(means, axis=0)
    return values, mean_recalls


def budget_points(auc: pd.DataFrame) -> list[tuple[str, float, int]]:
    """Return AUC ratios to the baseline with the budget in percent as MLflow step; step 101 means no budget."""
    points = []
    for curve in budget_curves(variants(auc)):
        for budget, variant in curve.variants.items():
            for method in ("random_budget", "adversarial"):
                ratio = variant.aucs.ratio_to_baseline(method, variant.vehicles)
                name = metric_name(f"auc_by_budget/{method}/{curve.title}")
                points += [(name, ratio, round(min(budget, 101.0)))] if ratio is not None else []
    return points


def _mean(group: pd.DataFrame, recalls: Mapping[tuple[str, ...], Recall]) -> Recall | None:
    """Average the recall of one vehicle over data sets, weighted by their number of scores."""
    counts = {_identity(row): row["scores"] for row in group.to_dict("records")}
    known = [key for key in counts if key in recalls]
    if not known:
        return None
    return np.asarray(np.average([recalls[key] for key in known], axis=0, weights=[counts[key] for key in known]))


def _recalls(curves: pd.DataFrame) -> dict[tuple[str, ...], Recall]:
    """Sample each group's step function at whole percents; the value on [t_i, t_i+1) is that at t_i."""
    found = {}
    for key, curve in curves.groupby([*_KEY, *_VARIANTS], sort=False, dropna=False):
        knots = curve["score_threshold"].to_numpy(dtype=np.float64)
        at = np.searchsorted(knots, _PERCENT, side="right") - 1
        found[tuple(map(_text, key))] = curve["recall"].to_numpy(dtype=np.float64)[np.maximum(at, 0)]
    return found


def _identity(row: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(_text(row[name]) for name in (*_KEY, *_VARIANTS))


def _text(value: Any) -> str:
    """Format a cell as text; a missing lambda (pose) is a dash."""
    return "-" if value is None or value != value else setting_text(value)
