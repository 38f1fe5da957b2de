"""The paper's own AUCs, to stand beside ours."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

from shift3d.analysis.variants import Aucs, Variant

PAPER_AUC = Path(__file__).resolve().parents[1] / "measured" / "paper_auc.json"
"""Copied from the paper's LaTeX: tab:auc_z, tab:auc_theta, tab:sst_auc_z, tab:sst_auc_theta."""


@dataclass(frozen=True)
class PaperTable:
    """One table. name: its label in the paper."""

    name: str
    aucs: Aucs


@functools.cache
def _tables() -> dict[tuple[str, str, str], PaperTable]:
    found = json.loads(PAPER_AUC.read_text(encoding="utf-8"))["tables"]
    return {(t["mode"], t["detector"], t["scored_by"]): PaperTable(t["table"], Aucs(t["auc"])) for t in found}


def paper_table(mode: str, detector: str, scored_by: str) -> PaperTable | None:
    """What the paper found for a detector that was attacked and one that scores; None where it has no such table.

    Beside the small SST stands the paper's SST.
    """
    return _tables().get((mode, detector.removesuffix("_small"), scored_by.removesuffix("_small")))


def paper_beside(variant: Variant) -> PaperTable | None:
    """The paper's table of a variant's vehicles, found by a search as the paper's, a descent over every code."""
    found = paper_table(variant.mode, variant.detector, variant.scored_by) if variant.search == "descent" else None
    known = {name for row in found.aucs.by_method.values() for name in row} if found else set()
    return found if known & set(variant.vehicles) else None
