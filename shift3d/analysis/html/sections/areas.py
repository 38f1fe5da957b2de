"""Areas under the threshold-recall curves, with intervals, and the paper's beside them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from shift3d.analysis.html.document import OPEN, Markup, Section, aside, escape, paragraph, table, terms
from shift3d.analysis.results import METHODS, Variant
from shift3d.analysis.statistics.areas import Area, area, mean_area, ratio_interval
from shift3d.analysis.tables.paper import PaperTable, paper_table
from shift3d.vehicles.outline import CAR_RULE
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["areas", "in_short"]

_MEANINGS = {
    "AUC": "area under recall(t) = P(score > t), t from 0 to 1: exactly the mean score of the best box within 5 m of "
    "the inserted vehicle, 0 where there is none",
    "interval": "95 %, BCa bootstrap, whole scenes redrawn; with fewer than about 20 scenes it is too narrow",
    "mean": "mean of the vehicles' AUCs; for the paper's rows it is computed here, over the vehicles shown",
    "of baseline": "mean over the baseline's mean; interval: 95 %, scenes redrawn with both of them",
    "still a car": f"only tasks whose adversarial shape is {CAR_RULE}, and the baseline of the same tasks: a coarse "
    "look, which some broken shapes pass",
    "lambda": "shape results are those of the weight that the paper's rule chose for each vehicle",
}


def areas(found: list[Variant]) -> Section:
    """The section: a table a variant."""
    if not found:
        return Section("auc", "Area under the curve", [paragraph("No task has a score.", "missing")])
    body = [paragraph("Lower means that the detector misses more of these vehicles."), terms(_MEANINGS)]
    for number, variant in enumerate(found):
        parts = _table(variant)
        body += parts if number < OPEN else [aside(f"AUC: {variant.label}", parts)]
    return Section("auc", "Area under the curve", body)


def in_short(found: list[Variant], unplaced: str | None = None) -> Section:
    """How far the mean AUC falls, a line a variant, and how far it fell in the paper over the same vehicles.

    unplaced: what is said where no vehicle found a place.
    """
    if not found:
        return Section("short", "In short", [paragraph(unplaced or "No task has a score.", "missing")])
    lines = [f"<li>{escape(_headline(variant))}</li>" for variant in found]
    return Section("short", "In short", [f"<ul>{''.join(lines)}</ul>"])


def _headline(variant: Variant) -> str:
    means = [mean_area(variant.rows[variant.rows["method"] == name]) for name in ("baseline", "adversarial")]
    before, after = means
    name = f"{variant.label[0].upper()}{variant.label[1:]}"
    if before is None or after is None:
        return f"{name}: no baseline, or nothing found."
    found, whole = (variant.rows[variant.rows["method"] == name] for name in ("adversarial", "baseline"))
    ratio = " ".join(part for part in _ratio(found, whole) if part)
    text = f"{name}: mean AUC {before.interval.mean:.3f} → {after.interval.mean:.3f}, {ratio} of the baseline's"
    paper = paper_table(variant.mode, variant.detector, variant.scored_by)
    if paper and {"baseline", "adversarial"} <= set(paper.auc):
        known = [vehicle for vehicle in variant.vehicles if vehicle in paper.auc["adversarial"]]
        if known:
            old, new = (sum(paper.auc[key][vehicle] for vehicle in known) for key in ("baseline", "adversarial"))
            text += f" (paper: {new / old:.2f})"
    return f"{text}; {counted(after.scenes, 'scene')}, {_vehicles(variant)}."


def _vehicles(variant: Variant) -> str:
    return counted(len(variant.vehicles), "vehicle")


def _table(variant: Variant) -> list[str]:
    paper = paper_table(variant.mode, variant.detector, variant.scored_by)
    vehicles = variant.vehicles
    if paper and not any(vehicle in row for row in paper.auc.values() for vehicle in vehicles):
        paper = None
    lines, kinds = [], []
    for method in METHODS:
        if method in variant.methods:
            lines.append(_ours(variant, METHODS[method], variant.rows, method))
            kinds.append("ours" if method == "adversarial" else "")
        if paper and method in paper.auc:
            lines.append(_papers(paper, method, vehicles))
            kinds.append("paper")
    cars = _cars(variant)
    if len(cars):
        for method in ("baseline", "adversarial"):
            lines.append(_ours(variant, f"{METHODS[method]}, still a car", cars, method))
            kinds.append("")
    if (chosen := _lambdas(variant)) is not None:
        lines.append(chosen)
        kinds.append("")
    named = [vehicle.replace("_", " ") for vehicle in vehicles]
    beside = f"; paper: {paper.name}, {variant.detector}, 500 scenes a vehicle" if paper else ""
    said = "" if "scored by" in variant.label else f", scored by {variant.scored_by}"
    caption = f"AUC, {variant.label}{said}{beside}"
    parts = [table(caption, ["method", *named, "mean", "of baseline"], lines, kinds), *_still_cars(variant)]
    if paper is None:
        parts.append(paragraph(f"The paper has no table of these vehicles for {variant.label}.", "missing"))
    return parts


def _ours(variant: Variant, label: str, of: pd.DataFrame, method: str) -> list[str]:
    """A line of one method. of: the rows that count, of all methods."""
    rows, baseline = of[of["method"] == method], of[of["method"] == "baseline"]
    cells = [_cell(area(rows[rows["vehicle"] == vehicle])) for vehicle in variant.vehicles]
    return [label, *cells, _cell(mean_area(rows)), _ratio_cell(rows, baseline)]


def _ratio(rows: pd.DataFrame, baseline: pd.DataFrame) -> tuple[str, str]:
    """The ratio of two AUCs and its interval, the latter nothing where it is a point or infinite."""
    found = ratio_interval(rows, baseline)
    if found is None:
        return "-", ""
    between = f"[{found.low:.2f}, {found.high:.2f}]" if 0 < found.high - found.low < math.inf else ""
    return f"{found.mean:.2f}", between


def _ratio_cell(rows: pd.DataFrame, baseline: pd.DataFrame) -> str:
    ratio, between = _ratio(rows, baseline)
    return Markup(f"{ratio}<small>{between}</small>") if between else ratio


def _cars(variant: Variant) -> pd.DataFrame:
    """Rows of the tasks whose shape is still a car; none where nothing was looked at."""
    if "still_a_car" not in variant.rows:
        return variant.rows.iloc[:0]
    return variant.rows[variant.rows["still_a_car"].eq(True)]


def _still_cars(variant: Variant) -> list[str]:
    """How many shapes are still cars."""
    if variant.mode != "shape" or "still_a_car" not in variant.rows or not variant.rows["still_a_car"].notna().any():
        return []
    tasks = variant.rows[variant.rows["still_a_car"].notna()].drop_duplicates("task_id")
    cars = tasks[tasks["still_a_car"].eq(True)]
    each = [f"{name.replace('_', ' ')} {(cars['vehicle'] == name).sum()} of {(tasks['vehicle'] == name).sum()}"
            for name in variant.vehicles]  # fmt: skip
    return [paragraph(f"Still a car: {len(cars)} of {len(tasks)} adversarial shapes ({', '.join(each)}).")]


def _cell(found: Area | None) -> str:
    if found is None:
        return "-"
    interval = found.interval
    known = math.isfinite(interval.low)
    between = f"[{interval.low:.3f}, {interval.high:.3f}]" if known else "no interval"
    scenes = f"{found.scenes} scene{'s' if found.scenes != 1 else ''}"
    return Markup(f"{interval.mean:.3f}<small>{escape(between)}</small><small>{scenes}</small>")


def _papers(paper: PaperTable, method: str, vehicles: list[str]) -> list[str]:
    row, first = paper.auc[method], paper.auc.get("baseline", {})
    known = [vehicle for vehicle in vehicles if vehicle in row]
    mean = sum(row[vehicle] for vehicle in known) / len(known)
    cells = [f"{row[vehicle]:.3f}" if vehicle in row else "-" for vehicle in vehicles]
    whole = [first[vehicle] for vehicle in known if vehicle in first]
    ratio = f"{mean / (sum(whole) / len(whole)):.2f}" if len(whole) == len(known) else "-"
    return [f"{METHODS[method]}, paper", *cells, f"{mean:.3f}", ratio]


def _lambdas(variant: Variant) -> list[str] | None:
    chosen = variant.rows.drop_duplicates("vehicle").set_index("vehicle")["lambda"]
    if not chosen.notna().any():
        return None
    return ["lambda", *(f"{chosen[vehicle]:g}" for vehicle in variant.vehicles), "", ""]
