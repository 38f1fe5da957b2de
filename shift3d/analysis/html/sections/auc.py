"""Scores: in short, by vehicle with the paper's beside them, by budget of naturalness, by sensor, and paired."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from typing import Any

from shift3d.analysis.html.blocks import Block, Fold, Items, Paragraph, Section, Terms, folded
from shift3d.analysis.html.figure import DASHES, LEGEND_BELOW, axis, plot, short
from shift3d.analysis.results import Sweep
from shift3d.analysis.statistics.intervals import Interval
from shift3d.analysis.statistics.paired import Paired, holm, paired
from shift3d.analysis.tables.auc import (
    auc_table,
    natural_rows,
    natural_sentence,
    natural_table,
    ratio_texts,
    with_baseline,
)
from shift3d.analysis.tables.budgets import ANY_SHAPE, BudgetCurve, budget_curves, budget_table
from shift3d.analysis.tables.paper import paper_table
from shift3d.analysis.tables.sensors import sensor_table
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import Variant, aucs_of_scores
from shift3d.methods import METHODS
from shift3d.naturalness.calibration import NATURAL_RULE
from shift3d.wording import counted

_SENTENCES = 3  # shown; the others unfold


def in_short(found: Sequence[Variant], caveat: str | None = None, unplaced: str | None = None) -> Section:
    """A sentence for each variant that the attacked detector scores itself; the others folded.

    caveat: what to know before reading AUCs. unplaced: what is told where no vehicle found a place.
    """
    known = [variant for variant in found if len(variant.rows)]
    if not known:
        return Section("short", "In short", [Paragraph(unplaced or "No task has a score.", "missing")])
    own = [variant for variant in known if variant.is_own] or known
    first, rest = own[:_SENTENCES], [variant for variant in known if variant not in own[:_SENTENCES]]
    blocks: list[Block] = [Paragraph(caveat, "caveat")] if caveat else []
    blocks += [Paragraph(headline(variant), "headline") for variant in first]
    if rest:
        summary = f"{counted(len(rest), 'more result')}: other detectors and settings"
        blocks.append(Fold(summary, [Items([headline(variant) for variant in rest])]))
    return Section("short", "In short", blocks)


def headline(variant: Variant) -> str:
    """The fall of the mean AUC, its ratio, the paper's, and in the same sentence how many shapes are unnatural."""
    rows, baseline = with_baseline(variant.rows, "adversarial")
    vehicles = [name for name in variant.vehicles if (baseline["vehicle"] == name).any()]
    before = aucs_of_scores(baseline).mean("baseline", vehicles)
    after = aucs_of_scores(rows).mean("adversarial", vehicles)
    if before is None or after is None:
        return f"{variant.title}: no baseline, or nothing found."
    ratio = " ".join(part for part in ratio_texts(rows, baseline) if part)
    paper = _papers_ratio(variant, vehicles)
    counts = f"{counted(len(vehicles), 'vehicle')} in {counted(rows['place'].nunique(), 'scene')}"
    return (
        f"{variant.title}: the mean AUC of {counts} {'falls' if after < before else 'goes'} from {before:.3f} to "
        f"{after:.3f}, a ratio of {ratio}{f' (paper: {paper:.2f})' if paper else ''}{_naturalness(variant)}."
    )


def _papers_ratio(variant: Variant, vehicles: list[str]) -> float | None:
    paper = paper_table(variant.mode, variant.detector, variant.scored_by, variant.search)
    return paper.aucs.of_baseline("adversarial", vehicles) if paper else None


def _naturalness(variant: Variant) -> str:
    """How many of the shapes are unnatural, and the ratio over the others."""
    if variant.mode == "pose":
        return ""
    tasks = variant.rows.drop_duplicates("task_id")
    measured = tasks[tasks["natural"].notna()] if "natural" in tasks else tasks.iloc[:0]
    if measured.empty:
        return "; how many of the shapes are unnatural was not measured"
    unnatural = int(measured["natural"].eq(False).sum())
    text = f", but {unnatural} of {counted(len(measured), 'shape')} {'is' if unnatural == 1 else 'are'} unnatural"
    left = len(measured) - unnatural
    if not unnatural:
        return ", and the one shape is natural" if left == 1 else f", and all {left} shapes are natural"
    ratio = aucs_of_scores(natural_rows(variant)).of_baseline("adversarial", variant.vehicles) if left else None
    return text + (f" (ratio over the {left} natural: {ratio:.2f})" if ratio is not None else "")


_SENSORS_LEAD = (
    "The same street and the same place, seen by another sensor from the same point. A baseline is one object under "
    "every sensor: what it loses is lost to the beams. An adversarial object was searched under its own beams. A miss "
    "under every sensor is the detector's; one under some sensors alone is for want of what these see. Differences are "
    "object by object; intervals redraw whole streets."
)


def sensors(sweep: Sweep) -> Section | None:
    """The section; None where a sweep has the beams of one sensor alone."""
    table = sensor_table(sweep.scores)
    return None if table is None else Section("sensors", "Sensor or detector", [Paragraph(_SENSORS_LEAD), table])


_SHOWN = 4  # variants whose tables are in sight; those of the others unfold
_MEANINGS = {
    "AUC": "area under recall(t) = P(score > t), t from 0 to 1: exactly the mean score of the best box within 5 m of "
    "the inserted vehicle, 0 where there is none",
    "interval": "95 %, BCa bootstrap, whole scenes redrawn; with fewer than about 20 scenes it is too narrow",
    "mean": "mean of the vehicles' AUCs; for the paper's rows it is computed here, over the vehicles shown",
    "of baseline": "mean over the baseline's mean; interval: 95 %, scenes redrawn with both of them",
    "natural": f"only tasks whose adversarial shape is {NATURAL_RULE}, and the baseline of the same tasks"
    "; see docs/why/naturalness.md",
    "lambda": "shape results are those of the weight that the paper's rule chose for each vehicle",
}


def auc(sweep: Sweep, found: Sequence[Variant]) -> Section:
    """The section: a table a variant."""
    title = "Area under the curve"
    if not any(len(variant.rows) for variant in found):
        return Section("auc", title, [Paragraph("No task has a score.", "missing")])
    lead = Paragraph("Lower means that the detector misses more of these vehicles.")
    parts = [(f"AUC: {variant.label}", auc_blocks(variant)) for variant in found]
    by_lambda = natural_table(sweep.scores)
    folds: list[Block] = [Fold("Natural shapes by lambda", [by_lambda])] if by_lambda else []
    folds.append(Fold("What the rows and columns mean", [Terms(_MEANINGS)]))
    return Section("auc", title, [lead, *folded(parts, _SHOWN), *folds])


def auc_blocks(variant: Variant) -> list[Block]:
    """The table in full, and how many shapes are natural."""
    blocks: list[Block] = [auc_table(variant, in_full=True)]
    if natural := natural_sentence(variant):
        blocks.append(Paragraph(natural))
    paper = paper_table(variant.mode, variant.detector, variant.scored_by, variant.search)
    if not paper or not set(variant.vehicles) & {name for row in paper.aucs.by_method.values() for name in row}:
        blocks.append(Paragraph(f"The paper has no table of these vehicles for {variant.label}.", "missing"))
    return blocks


_PAIRS = (
    ("adversarial", "baseline"),
    ("random", "baseline"),
    ("adversarial", "random"),
    ("adversarial_noise", "adversarial"),
)
_HEADER = ["comparison", "vehicle", "difference", "95 % interval", "scenes", "tasks", "p", "p, Holm"]
_PAIRED_LEAD = (
    "The same vehicle at the same place of the same scene: score of the first method minus that of the second "
    "(replicates averaged). Intervals redraw whole scenes. p is Wilcoxon's signed-rank test, two-sided, over the "
    "scenes' mean differences (with fewer than 6 scenes it cannot fall below 0.05); Holm's correction is over the "
    "comparisons of its table."
)


def differences(found: Sequence[Variant]) -> Section:
    """The section: a table a variant, folded."""
    tables = [(variant, table) for variant in found if (table := _differences_table(variant))]
    folds: list[Block] = [Fold(f"Paired differences: {variant.label}", [table]) for variant, table in tables]
    if not folds:
        folds = [Paragraph("No task has the scores of two methods.", "missing")]
    return Section("differences", "Paired differences", [Paragraph(_PAIRED_LEAD), *folds])


def _differences_table(variant: Variant) -> Table | None:
    results = [
        (pair, name, result)
        for pair in _PAIRS
        for name, rows in variant.by_vehicle()
        if (result := paired(rows, *pair)) is not None
    ]
    if not results:
        return None
    corrected = holm([result.p_value for *_, result in results])
    lines = [_line(*item, value) for item, value in zip(results, corrected)]
    kinds = ["ours" if pair == _PAIRS[0] else "" for pair, *_ in results]
    return Table(f"Paired differences of the score, {variant.label}", _HEADER, lines, kinds)


def _line(pair: tuple[str, str], vehicle: str, result: Paired, corrected: float | None) -> list[str]:
    interval = result.interval
    known = math.isfinite(interval.low)
    between = f"[{interval.low:+.3f}, {interval.high:+.3f}]" if known else "one scene: none"
    counts = [str(result.scenes), str(result.tasks)]
    compared = f"{METHODS[pair[0]]} - {METHODS[pair[1]]}"
    tests = [_p_value(result.p_value), _p_value(corrected)]
    return [compared, vehicle, f"{interval.mean:+.3f}", between, *counts, *tests]


def _p_value(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"


_BUDGETS_LEAD = (
    "AUC over the baseline's, against the percentile of the reference set that a searched shape may not pass: at 95, "
    "95 of 100 known vehicles lie nearer to the others than the shape does. Bars: 95 %, scenes redrawn. Random draws "
    "have the same budget and as many evaluations; the distance to them is what the search is worth."
)
_COLOURS = ("#d55e00", "#2f8fc9", "#2c9668", "#9467bd", "#b97a00", "#7d7d7d")


def budgets(found: Sequence[Variant]) -> Section | None:
    """The section; None where no search ran under two budgets."""
    curves, table = budget_curves(found), budget_table(found)
    if table is None:
        return None
    traces = [trace for curve, colour in zip(curves, cycle(_COLOURS)) for trace in _budget_traces(curve, colour)]
    layout: dict[str, Any] = {
        "xaxis": axis("percentile of the reference set", type="category"),
        "yaxis": axis("AUC, of baseline", rangemode="tozero"),
        "legend": LEGEND_BELOW,
    }
    caption = "AUC over the baseline's against the budget of naturalness"
    figure = plot("budgets", traces, layout, caption, caption, 380)
    return Section("budgets", "How hard vehicles get that stay vehicles", [Paragraph(_BUDGETS_LEAD), figure, table])


def _budget_traces(curve: BudgetCurve, colour: str) -> list[dict[str, Any]]:
    """A line a method, with bars. The solution's is solid, that of the random draws dashed."""
    traces = []
    for method in ("random_search", "adversarial"):
        known = {budget: found for budget in curve.variants if (found := curve.ratio(budget, method)) is not None}
        if not known:
            continue
        name = f"{curve.title}: {METHODS[method]}"
        x = ["any shape" if budget == ANY_SHAPE else f"{budget:g}" for budget in known]
        y = short([found.mean for found in known.values()])
        traces.append(
            {"type": "scatter", "mode": "lines+markers", "x": x, "y": y, "error_y": _bars(list(known.values())),
             "line": {"color": colour, "dash": DASHES[method], "width": 3 if method == "adversarial" else 2},
             "name": name, "hovertemplate": f"{name} %{{y:.3f}}<extra></extra>"}
        )  # fmt: skip
    return traces


def _bars(found: Sequence[Interval]) -> dict[str, Any]:
    """Bars of an interval's ends; none of a single scene, which has no interval."""
    if any(one.high == float("inf") for one in found):
        return {"visible": False}
    up, down = ([one.high - one.mean for one in found], [one.mean - one.low for one in found])
    return {"type": "data", "symmetric": False, "array": short(up), "arrayminus": short(down), "thickness": 1}
