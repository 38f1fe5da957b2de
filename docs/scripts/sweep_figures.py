"""Figures of a finished sweep: AUCs with intervals, and every number of the tables that it prints.

``python docs/scripts/sweep_figures.py OUT [json=FILE]``: OUT is the sweep's folder. An AUC is named
VARIANT/METHOD/VEHICLE, with mean and "of baseline" after the vehicles; a table's number TABLE/LINE/COLUMN.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from shift3d.analysis.html.sections.bev import pooled_cells
from shift3d.analysis.html.sections.paths import mean_path, searched
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.intervals import Interval, mean_interval, ratio_interval, vehicle_mean_interval
from shift3d.analysis.statistics.paired import paired
from shift3d.analysis.tables.auc import with_baseline
from shift3d.analysis.tables.budgets import budget_table
from shift3d.analysis.tables.choices import reasons
from shift3d.analysis.tables.effects import effect_impacts, effect_milliseconds
from shift3d.analysis.tables.failure_rules import failure_rules, rule_objects, rule_text
from shift3d.analysis.tables.retrieval import pool_table, retrieval_table
from shift3d.analysis.tables.sensors import transfer_table
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import Variant, aucs_of_scores, variants
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic

__all__ = ["sweep_figures"]

_STEPS = (0, 1, 2, 5, 10, 20, 40)
_OBJECT = ["vehicle", "scored_by", "place"]
_OFTEN = 5  # scores that a cell needs for a reliable mean
Figures = Iterator[tuple[str, dict[str, Any]]]


def sweep_figures(sweep: Sweep) -> dict[str, dict[str, Any]]:
    """Return name to value, unit, interval, n."""
    found = dict(_size(sweep))
    parts = variants(sweep.auc, sweep.scored)
    for variant in parts:
        found |= dict(_aucs(variant)) | dict(_cells(sweep, variant)) | dict(_path(sweep, variant))
        found |= dict(_beside_random_draws(sweep, variant)) | dict(_descent(sweep, variant))
    if not sweep.choices.empty:
        found |= {f"choice/{number}": _one(why) for number, why in enumerate(reasons(sweep.choices))}
    found |= dict(_numbers("budget", budget_table(parts)))
    found |= dict(_numbers("elsewhere", transfer_table(sweep.transfers), named_by=2))
    found |= dict(_numbers("retrieved", retrieval_table(sweep.retrieved), named_by=2))
    if not sweep.vehicle_pool.empty:
        found |= dict(_numbers("pool", pool_table(sweep.vehicle_pool)))
    return found | dict(_effects(sweep)) | dict(_verified(sweep)) | dict(_rules(sweep)) | dict(_edits(sweep))


def _one(
    value: float | str, unit: str = "", interval: tuple[float, float] | None = None, n: int | None = None
) -> dict[str, Any]:
    return {"value": value, "unit": unit, "interval": interval, "n": n}


def _within(value: float, between: Interval | None, unit: str, n: int | None = None) -> dict[str, Any]:
    """Return value and interval as a figure, without an interval that is a point or infinite."""
    known = between is not None and 0 < between.high - between.low < float("inf")
    return _one(value, unit, (between.low, between.high) if between and known else None, n)


def _size(sweep: Sweep) -> Figures:
    attempts = sweep.attempts
    seconds = (attempts["started_unix_s"] + attempts["seconds"]).max() - attempts["started_unix_s"].min()
    yield "tasks", _one(len(sweep.plan.tasks))
    yield "tasks scored", _one(sweep.scored["task_id"].nunique())
    yield "quarantined", _one(int(attempts["quarantined"].sum()))
    yield "scenes", _one(sweep.scored["place"].nunique())
    yield "minutes", _one(float(seconds) / 60, "min")


def _aucs(variant: Variant) -> Figures:
    for method in variant.methods:
        rows, base = with_baseline(variant.rows, method)
        label = f"{variant.title}/{method}"
        for vehicle in variant.vehicles:
            value = variant.aucs.of(method, vehicle)
            if value is not None:
                yield f"{label}/{vehicle}", _one(value, "AUC", n=int(rows["vehicle"].eq(vehicle).sum()))
        mean = variant.aucs.mean(method, variant.vehicles)
        ratio = aucs_of_scores(pd.concat([rows, base])).ratio_to_baseline(method, variant.vehicles)
        if mean is not None:
            yield f"{label}/mean", _within(mean, vehicle_mean_interval(rows), "AUC", len(rows))
        if ratio is not None and method != "baseline":
            yield f"{label}/of baseline", _within(ratio, ratio_interval(rows, base), "ratio", len(rows))


def _beside_random_draws(sweep: Sweep, variant: Variant) -> Figures:
    """Compare a search with as many random draws: difference of scores, share of natural shapes, and their kinds."""
    below = paired(variant.rows, "adversarial", "random_budget")
    if below is None:
        return
    yield (
        f"{variant.title}/adversarial/less random draws",
        _within(below.interval.mean, below.interval, "AUC", below.tasks),
    )
    if not variant.scores_itself:  # both methods have the same shapes
        return
    tasks = variant.rows["task_id"].unique()
    for method in ("adversarial", "random_budget"):
        # Each method needs its own shape's naturalness: `natural` of the variant's rows is the adversarial shape's.
        rows = sweep.scores[sweep.scores["task_id"].isin(tasks) & (sweep.scores["method"] == method)]
        rows = rows[(rows["scored_by"] == variant.scored_by) & rows["score"].notna()]
        yield f"{variant.title}/{method}/natural", _one(int(rows["natural"].eq(True).sum()), n=len(rows))
        own = sweep.solutions[sweep.solutions["task_id"].isin(tasks) & (sweep.solutions["method"] == method)]
        for kind, count in own["drawn_as"].fillna(own["vehicle"]).value_counts().items():
            yield f"{variant.title}/{method} drawn as/{kind}", _one(int(count), n=len(own))


def _descent(sweep: Sweep, variant: Variant) -> Figures:
    """Return by how much a descent lowers the loss: mean of its last quarter of steps minus that of its first.

    Differences are taken task by task. Random draws for a start are not steps.
    """
    rows = searched(sweep, variant) if variant.scores_itself else sweep.trajectories.iloc[:0]
    if rows.empty:
        return
    (task,) = sweep.plan.tasks.starting_with(rows["task_id"].iloc[0])
    attack = task.spec.attack
    if attack.search not in ("descent", "expectation"):
        return
    first = max(attack.starts, 1) if attack.search == "expectation" else 1
    table = rows[rows["step"] >= first].pivot_table(index=["place", "task_id"], columns="step", values="loss")
    losses = table.sort_index(axis=1).ffill(axis=1).to_numpy()
    quarter = losses.shape[1] // 4
    if not quarter:
        return
    fall = losses[:, -quarter:].mean(axis=1) - losses[:, :quarter].mean(axis=1)
    known = mean_interval(fall, list(table.index.get_level_values("place")))
    yield f"{variant.title}/adversarial/loss, last quarter less first", _within(known.mean, known, "loss", len(fall))


def _cells(sweep: Sweep, variant: Variant) -> Figures:
    cells = pooled_cells(sweep.bev_transfer, variant)
    if cells.empty:
        return
    fallen, often = cells["mean_reduction"] > 0, cells["scores"] >= _OFTEN
    yield "placements", _one(int(cells["scores"].sum()))
    yield "cells", _one(len(cells))
    yield "cells with a fall", _one(int(fallen.sum()), n=len(cells))
    yield "mean fall", _one(float(cells["mean_reduction"].mean()), "score")
    yield "cells with five or more", _one(int(often.sum()))
    yield "of these with a fall", _one(int((fallen & often).sum()), n=int(often.sum()))


def _path(sweep: Sweep, variant: Variant) -> Figures:
    rows = searched(sweep, variant) if variant.scores_itself else sweep.trajectories.iloc[:0]
    if rows.empty or sweep.plan.sweep != "trajectories":
        return
    steps, mean, low, high = mean_path(rows)
    at = {int(step): place for place, step in enumerate(steps)}
    for step in (step for step in _STEPS if step in at):
        between = None if low is None else (float(low[at[step]]), float(high[at[step]]))
        yield f"step/{step}", _one(float(mean[at[step]]), "score", between)


def _effects(sweep: Sweep) -> Figures:
    try:
        impacts = effect_impacts(sweep.scores, effect_milliseconds(sweep.scores, sweep.timings))
    except InputError:  # the sweep does not compare scenes with and without effects
        return
    for impact in impacts:
        changes = {"change": impact.score_change, "AUC, adversarial": impact.auc_adversarial}
        for name, change in changes.items():
            if change:
                yield f"effects/{impact.effect}/{name}", _within(change.mean, change, "score", impact.objects)


def _rules(sweep: Sweep) -> Figures:
    """Return, for a sweep made for failure rules, how much lower the score is under a rule, by object group."""
    if sweep.plan.sweep != "failure_rules":
        return
    objects = rule_objects(sweep)
    for detector, rows in objects.groupby("scored_by"):
        yield f"objects scored by {detector}", _within(float(rows["score"].mean()), None, "score", len(rows))
    for tried in failure_rules(objects):
        label = f"rule/{rule_text(tried.rule)}"
        yield f"{label}/holds", _one(int(tried.confirmed))
        yield f"{label}/where it was found", _within(tried.found.mean, tried.found, "score", tried.objects)
        for group, interval in tried.tried.items():
            if interval:
                yield f"{label}/{group}", _within(interval.mean, interval, "score")


def _edits(sweep: Sweep) -> Figures:
    """Return size and mean score at both values of `attack.edit`, and the change of the score between them."""
    rows = sweep.scored[sweep.scored["method"] == "edited"]
    edits = list(dict.fromkeys(rows["search"]))
    if len(edits) != 2:
        return
    sizes = sweep.shapes[sweep.shapes["method"] == "edited"].set_index("task_id")[["length_m", "width_m", "height_m"]]
    rows = rows.join(sizes, on="task_id")
    wide = rows.pivot_table(index=_OBJECT, columns="search", values=["score", *sizes])
    for (vehicle, detector), pairs in wide.dropna().groupby(_OBJECT[:2], sort=False):
        label, places = f"edits/{vehicle} {detector}", list(pairs.index.get_level_values("place"))
        for number, edit in enumerate(edits):
            for what, unit in (("score", "score"), *((size, "m") for size in sizes)):
                yield f"{label}/{what} {number}", _one(float(pairs[what, edit].mean()), unit, n=len(pairs))
        change = mean_interval(pairs["score", edits[1]] - pairs["score", edits[0]], places)
        yield f"{label}/change", _within(change.mean, change, "score", len(pairs))


def _verified(sweep: Sweep) -> Figures:
    """Count the outcomes of solutions that the attacked detector scored again."""
    if sweep.verification is None:
        return
    every, scores = sweep.verification, sweep.scores
    rows = every[(every["method"] == "adversarial") & (every["scored_by"] == every["detector"])]
    apart = (rows["score"] - rows["score_reference"]).abs()
    sums = {name: int(rows[name].sum()) for name in ("stable", "robust", "missed_hits", "wrong_surface")}
    sums |= {"hits": int(rows["hits_reference"].sum()), "within 0.02": int((apart <= 0.02).sum())}
    sums |= {"same again": int((rows["score"] == rows["score_again"]).sum())}
    sums |= {"not finite": int(scores["non_finite"].sum()), "unresolved": int(rows["unresolved_beams"].sum())}
    for name, value in sums.items():
        yield f"verified/{name}", _one(value, n=len(rows))
    means = {"mean score": rows["score"].mean(), "mean score at reference": rows["score_reference"].mean()}
    for name, value in {**means, "median change": apart.median(), "largest change": apart.max()}.items():
        yield f"verified/{name}", _one(float(value), "score", n=len(rows))


def _numbers(title: str, table: Table | None, named_by: int = 1) -> Figures:
    """Yield cells that begin with a number. "[a, b]" is an interval. named_by: number of columns that name a line."""
    for line in table.lines if table else ():
        for column, cell in zip(table.header[named_by:] if table else (), line[named_by:]):
            text = cell if isinstance(cell, str) else " ".join(cell)
            number = re.match(r"[-+]?\d[\d,]*(\.\d+)?(e[-+]?\d+)?", text)
            between = re.search(r"\[([-+\d.]+), ([-+\d.]+)\]", text)
            if number:
                ends = (float(between[1]), float(between[2])) if between else None
                name = " ".join(str(word) for word in line[:named_by]).replace("/", " ")
                yield f"{title}/{name}/{column}", _one(float(number[0].replace(",", "")), "", ends)


if __name__ == "__main__":
    (out,) = (word for word in sys.argv[1:] if "=" not in word)
    text = json.dumps(sweep_figures(read_sweep(out)), indent=1) + "\n"
    for word in sys.argv[1:]:
        if word.startswith("json="):
            write_atomic(Path(word.removeprefix("json=")), text.encode())
    print(text, end="")
