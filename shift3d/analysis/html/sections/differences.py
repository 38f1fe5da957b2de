"""Paired differences between methods, with intervals and tests."""

from __future__ import annotations

import math
from collections.abc import Sequence

from shift3d.analysis.html.blocks import Block, Fold, Paragraph, Section
from shift3d.analysis.statistics.paired import Paired, holm, paired
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import Variant
from shift3d.methods import METHODS

_PAIRS = (
    ("adversarial", "baseline"),
    ("random", "baseline"),
    ("adversarial", "random"),
    ("adversarial_noise", "adversarial"),
)
_HEADER = ["comparison", "vehicle", "difference", "95 % interval", "scenes", "tasks", "p", "p, Holm"]
_LEAD = (
    "The same vehicle at the same place of the same scene: score of the first method minus that of the second "
    "(replicates averaged). Intervals redraw whole scenes. p is Wilcoxon's signed-rank test, two-sided, over the "
    "scenes' mean differences (with fewer than 6 scenes it cannot fall below 0.05); Holm's correction is over the "
    "comparisons of its table."
)


def differences(found: Sequence[Variant]) -> Section:
    """The section: a table a variant, folded."""
    tables = [(variant, table) for variant in found if (table := _table(variant))]
    folds: list[Block] = [Fold(f"Paired differences: {variant.label}", [table]) for variant, table in tables]
    if not folds:
        folds = [Paragraph("No task has the scores of two methods.", "missing")]
    return Section("differences", "Paired differences", [Paragraph(_LEAD), *folds])


def _table(variant: Variant) -> Table | None:
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
