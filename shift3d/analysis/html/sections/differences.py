"""Paired differences between methods, with intervals and tests."""

from __future__ import annotations

import math

from shift3d.analysis.html.document import OPEN, Section, aside, paragraph, table
from shift3d.analysis.results import METHODS, Variant
from shift3d.analysis.statistics.areas import Paired, holm, paired

__all__ = ["differences"]

_PAIRS = (
    ("adversarial", "baseline"),
    ("random", "baseline"),
    ("adversarial", "random"),
    ("adversarial_noise", "adversarial"),
)
_HEADER = ["comparison", "vehicle", "difference", "95 % interval", "scenes", "tasks", "p", "p, Holm"]


def differences(found: list[Variant]) -> Section:
    """The section: a table a variant."""
    body = [
        paragraph(
            "The same vehicle at the same place of the same scene: score of the first method minus that of the second "
            "(replicates averaged). Intervals redraw whole scenes. p is Wilcoxon's signed-rank test, two-sided, over "
            "the scenes' mean differences (with fewer than 6 scenes it cannot fall below 0.05); Holm's correction is "
            "over the comparisons of its table."
        )
    ]
    for number, variant in enumerate(found):
        compared = _compared(variant)
        if compared:
            corrected = holm([result.p_value for _, _, result in compared])
            lines = [_line(*item, value) for item, value in zip(compared, corrected)]
            kinds = ["ours" if item[0] == _PAIRS[0] else "" for item in compared]
            part = table(f"Paired differences of the score, {variant.label}", _HEADER, lines, kinds)
            body.append(part if number < OPEN else aside(f"Paired differences: {variant.label}", [part]))
    if len(body) == 1:
        body.append(paragraph("No task has the scores of two methods.", "missing"))
    return Section("differences", "Paired differences", body)


def _compared(variant: Variant) -> list[tuple[tuple[str, str], str, Paired]]:
    vehicles = variant.vehicles
    chosen = [(name.replace("_", " "), variant.rows[variant.rows["vehicle"] == name]) for name in vehicles]
    if len(vehicles) > 1:
        chosen.append(("all", variant.rows))
    results = []
    for pair in _PAIRS:
        for name, rows in chosen:
            if (result := paired(rows, *pair)) is not None:
                results.append((pair, name, result))
    return results


def _line(pair: tuple[str, str], vehicle: str, result: Paired, corrected: float | None) -> list[str]:
    interval = result.interval
    known = math.isfinite(interval.low)
    between = f"[{interval.low:+.3f}, {interval.high:+.3f}]" if known else "one scene: none"
    return [
        f"{METHODS[pair[0]]} - {METHODS[pair[1]]}",
        vehicle,
        f"{interval.mean:+.3f}",
        between,
        str(result.scenes),
        str(result.tasks),
        _p_value(result.p_value),
        _p_value(corrected),
    ]


def _p_value(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
