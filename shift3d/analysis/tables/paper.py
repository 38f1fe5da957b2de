"""The paper's own AUCs, to stand beside ours."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

from shift3d.analysis.variants import Aucs

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


def paper_table(mode: str, detector: str, scored_by: str, search: str = "descent") -> PaperTable | None:
    """What the paper found for a detector that was attacked and one that scores; None where it has no such table.

    search: as in the results' column; the paper's is a descent over every code.

    Beside the small SST stands the paper's SST.
    """
    if search != "descent":
        return None
    return _tables().get((mode, detector.removesuffix("_small"), scored_by.removesuffix("_small")))
