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
    "Several sensors scan the same vehicle at the same place of the same street, from the same point. The baseline is "
    "one object under every sensor, so only the beams change its score. Each adversarial object was searched under its "
    "own sensor's beams. A miss under every sensor is the detector's failure; a miss under only some sensors is due to "
    "their beams. Differences are paired by object; intervals resample whole streets."
)


def sensors(sweep: Sweep) -> list[Block]:
    """Build the section that compares sensors; empty if a sweep has only one sensor's beams."""
    table = sensor_table(sweep.scores)
    return [Paragraph(_LEAD), table] if table else []


_SHOWN = 4  # number of variants whose tables are not folded
_MEANINGS = {
    "AUC": "area under recall(t) = P(score > t) for t from 0 to 1; exactly equal to the mean score of the best box "
    "within attack.detection_radius_m (5 m by default) of the inserted vehicle (0 without such a box)",
    "interval": "95 %, BCa bootstrap over whole scenes; too narrow with fewer than about 20 scenes",
    "mean": "mean of the vehicles' AUCs; in the paper's rows, shift3d computes it over the vehicles shown",
    "of baseline": "mean divided by the baseline's mean; interval: 95 %, both resampled by the same scenes",
    "natural": f"only tasks whose adversarial shape is {NATURAL_RULE}, with the baselines of the same tasks"
    "; see docs/why/naturalness.md",
    "lambda": "weight that the paper's rule chose for each vehicle; shape results use this weight",
}


def auc(sweep: Sweep, found: Sequence[Variant]) -> list[Block]:
    """Build the AUC section, with one table per variant."""
    if not any(len(variant.rows) for variant in found):
        return [missing("No task has a score.")]
    lead = Paragraph("A lower AUC means that the detector misses more of these vehicles.")
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
    ("edited", "baseline"),
    ("adversarial", "random"),
    ("adversarial", "random_budget"),
    ("adversarial_noise", "adversarial"),
)
_HEADER = ["comparison", "vehicle", "difference", "95 % interval", "scenes", "tasks", "p", "p, Holm"]
_PAIRED_LEAD = (
    "Score of the first method minus score of the second, for the same vehicle at the same place of the same scene "
    "(replicates averaged). Intervals resample whole scenes. p is from Wilcoxon's two-sided signed-rank test over the "
    "scenes' mean differences (with fewer than 6 scenes it cannot fall below 0.05). Holm's correction covers the "
    "comparisons of one table."
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
    ends = between(result.interval, 3, "+") or "none (one scene)"
    counts = [str(result.scenes), str(result.tasks)]
    tests = [_p_value(result.p_value), _p_value(corrected)]
    return [compared, vehicle, f"{result.interval.mean:+.3f}", ends, *counts, *tests]


def _p_value(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
