"""Sections with scores: AUCs beside the paper's, comparison of sensors, and paired differences."""

from __future__ import annotations

from collections.abc import Sequence

from shift3d.analysis.html.blocks import Block, Collapsible, Paragraph, Terms, folded, missing
from shift3d.analysis.results import Sweep
from shift3d.analysis.statistics.paired import PairedDifference, holm, paired
from shift3d.analysis.tables.auc import auc_table, natural_sentence, natural_table
from shift3d.analysis.tables.paper import paper_table_of
from shift3d.analysis.tables.sensors import sensor_table
from shift3d.analysis.tables.table import Table, between
from shift3d.analysis.variants import Variant
from shift3d.methods import METHODS
from shift3d.naturalness.calibration import NATURAL_RULE

_LEAD = (
    "The same street and the same place, seen by another sensor from the same point. A baseline is one object under "
    "every sensor: what it loses is lost to the beams. An adversarial object was searched under its own beams. A miss "
    "under every sensor is the detector's; one under some sensors alone is for want of what these see. Differences are "
    "object by object; intervals redraw whole streets."
)


def sensors(sweep: Sweep) -> list[Block]:
    """Build the section that compares sensors; empty if a sweep has only one sensor's beams."""
    table = sensor_table(sweep.scores)
    return [Paragraph(_LEAD), table] if table else []


_SHOWN = 4  # number of variants whose tables are not folded
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


def auc(sweep: Sweep, found: Sequence[Variant]) -> list[Block]:
    """Build the AUC section, with one table per variant."""
    if not any(len(variant.rows) for variant in found):
        return [missing("No task has a score.")]
    lead = Paragraph("Lower means that the detector misses more of these vehicles.")
    parts = [(f"AUC: {variant.label}", auc_blocks(variant)) for variant in found]
    by_lambda = natural_table(sweep.scores)
    folds: list[Block] = [Collapsible("Natural shapes by lambda", [by_lambda])] if by_lambda else []
    folds.append(Collapsible("What the rows and columns mean", [Terms(_MEANINGS)]))
    return [lead, *folded(parts, _SHOWN), *folds]


def auc_blocks(variant: Variant) -> list[Block]:
    """Build the full table of a variant, with the number of natural shapes."""
    blocks: list[Block] = [auc_table(variant, in_full=True)]
    if natural := natural_sentence(variant):
        blocks.append(Paragraph(natural))
    if not paper_table_of(variant):
        blocks.append(missing(f"The paper has no table of these vehicles for {variant.label}."))
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


def differences(found: Sequence[Variant]) -> list[Block]:
    """Build the section of paired differences, with one folded table per variant."""
    tables = [(variant, table) for variant in found if (table := _differences_table(variant))]
    folds: list[Block] = [Collapsible(f"Paired differences: {variant.label}", [table]) for variant, table in tables]
    return [Paragraph(_PAIRED_LEAD), *(folds or [missing("No task has the scores of two methods.")])]


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


def _line(pair: tuple[str, str], vehicle: str, result: PairedDifference, corrected: float | None) -> list[str]:
    compared = f"{METHODS[pair[0]]} - {METHODS[pair[1]]}"
    ends = between(result.interval, 3, "+") or "one scene: none"
    counts = [str(result.scenes), str(result.tasks)]
    tests = [_p_value(result.p_value), _p_value(corrected)]
    return [compared, vehicle, f"{result.interval.mean:+.3f}", ends, *counts, *tests]


def _p_value(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
