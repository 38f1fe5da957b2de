"""AUCs published in the paper, for comparison."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

from shift3d.analysis.variants import Aucs, Variant

# Copied from the paper's LaTeX: tab:auc_z, tab:auc_theta, tab:sst_auc_z, tab:sst_auc_theta.
PAPER_AUC = Path(__file__).resolve().parents[1] / "measured" / "paper_auc.json"


@dataclass(frozen=True)
class PaperTable:
    """One table of the paper. name: its LaTeX label."""

    name: str
    aucs: Aucs


@functools.cache
def _tables() -> dict[tuple[str, str, str], PaperTable]:
    found = json.loads(PAPER_AUC.read_text(encoding="utf-8"))["tables"]
    return {(t["mode"], t["detector"], t["scored_by"]): PaperTable(t["table"], Aucs(t["auc"])) for t in found}


def paper_table(mode: str, detector: str, scored_by: str) -> PaperTable | None:
    """Return the paper's table for attacked and scoring detector, or None; the small SST takes the paper's SST."""
    return _tables().get((mode, detector.removesuffix("_small"), scored_by.removesuffix("_small")))


def paper_table_of(variant: Variant) -> PaperTable | None:
    """Return the paper's table of a variant's vehicles; None unless the search is a descent over every code."""
    found = paper_table(variant.mode, variant.detector, variant.scored_by) if variant.search == "descent" else None
    known = {name for row in found.aucs.by_method.values() for name in row} if found else set()
    return found if known & set(variant.vehicles) else None
