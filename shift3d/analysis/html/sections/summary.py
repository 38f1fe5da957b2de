"""Section with the result in one or two sentences: fall of the AUC, and number of natural shapes."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from shift3d.analysis.html.blocks import Block, Collapsible, Items, Paragraph, missing
from shift3d.analysis.tables.auc import natural_rows, ratio_texts, with_baseline
from shift3d.analysis.tables.paper import paper_table_of
from shift3d.analysis.variants import Variant, aucs_of_scores
from shift3d.wording import counted

_SHOWN = 3


def in_short(
    found: Sequence[Variant], caveat: str | None = None, unplaced: str | None = None, further: str | None = None
) -> list[Block]:
    """Build one sentence for each variant that the attacked detector scores; other variants are folded.

    caveat: warning before the AUCs. unplaced: text if no vehicle found a place. further: suggested next command.
    """
    known = [variant for variant in found if len(variant.rows)]
    if not known:
        return [missing(unplaced or "No task has a score.")]
    own = [variant for variant in known if variant.scores_itself] or known
    first, rest = own[:_SHOWN], [variant for variant in known if variant not in own[:_SHOWN]]
    blocks: list[Block] = [Paragraph(caveat, "caveat")] if caveat else []
    blocks += [Paragraph(headline(variant), "headline") for variant in first]
    if rest:
        summary = f"{counted(len(rest), 'more result')}: other detectors and settings"
        blocks.append(Collapsible(summary, [Items([headline(variant) for variant in rest])]))
    return [*blocks, *([Paragraph(f"{further}.")] if further else [])]


def headline(variant: Variant) -> str:
    """Describe the fall of the mean AUC, its ratio, the paper's ratio, and the number of unnatural shapes."""
    rows, baseline = with_baseline(variant.rows, "adversarial")
    vehicles = [name for name in variant.vehicles if (baseline["vehicle"] == name).any()]
    before = aucs_of_scores(baseline).mean("baseline", vehicles)
    after = aucs_of_scores(rows).mean("adversarial", vehicles)
    if before is None or after is None:
        return f"{variant.title}: the baseline or the solutions have no score."
    ratio = " ".join(part for part in ratio_texts(rows, baseline) if part)
    table = paper_table_of(variant)
    paper = table and table.aucs.ratio_to_baseline("adversarial", vehicles)
    counts = f"{counted(len(vehicles), 'vehicle')} in {counted(rows['place'].nunique(), 'scene')}"
    return (
        f"{variant.title}: the mean AUC of {counts} {'falls' if after < before else 'goes'} from {before:.3f} to "
        f"{after:.3f}, a ratio of {ratio}{f' (paper: {paper:.2f})' if paper else ''}"
        f"{_unchanged(rows)}{_naturalness(variant)}."
    )


def _unchanged(rows: pd.DataFrame) -> str:
    """Describe the number of tasks whose search kept the baseline. rows: of the adversarial objects."""
    tasks = rows.drop_duplicates("task_id")
    kept = int(tasks["best_step"].eq(0).sum())
    return f", with {kept} of {counted(len(tasks), 'task')} unchanged by the search" if kept else ""


def _naturalness(variant: Variant) -> str:
    """Describe the number of unnatural shapes, and the ratio over the natural ones."""
    if variant.mode == "pose":
        return ""
    tasks = variant.rows[variant.rows["method"].eq("adversarial") & variant.rows["best_step"].ne(0)]
    tasks = tasks.drop_duplicates("task_id")
    measured = tasks[tasks["natural"].notna()]
    if measured.empty:
        return "; the naturalness of the shapes was not measured" if len(tasks) else ""
    unnatural = int(measured["natural"].eq(False).sum())
    text = f", but {unnatural} of {counted(len(measured), 'shape')} {'is' if unnatural == 1 else 'are'} unnatural"
    left = len(measured) - unnatural
    if not unnatural:
        return ", and the one shape is natural" if left == 1 else f", and all {left} shapes are natural"
    ratio = aucs_of_scores(natural_rows(variant)).ratio_to_baseline("adversarial", variant.vehicles) if left else None
    return text + (f" (ratio over {counted(left, 'natural shape')}: {ratio:.2f})" if ratio is not None else "")
