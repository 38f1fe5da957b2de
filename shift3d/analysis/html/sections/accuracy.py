"""What the sweep's accuracy was, what it cost, and what other presets would."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Block, Fold, Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy_cost import accuracy_cost, measured_presets
from shift3d.analysis.tables.accuracy_time import settings_table
from shift3d.analysis.tables.numerics import diagnostics

__all__ = ["accuracy"]

_HEADERS = ("time", "x paper", "missed", "wrong", "false", "p99", "max", "cosine", "step", "AUC")


def accuracy(sweep: Sweep) -> Section:
    """The section: the audit of this sweep's own objects, and the presets as a frontier measured them."""
    presets, whose = measured_presets()
    lines = accuracy_cost(sweep.scores, sweep.timings, presets, whose).splitlines()[1:]
    blocks: list[Block] = [Paragraph(line.strip()) for line in lines]
    blocks.append(Paragraph(diagnostics(sweep.scores)))
    table = settings_table(presets.reset_index(), f"Presets, by {whose}", "preset", _HEADERS)
    return Section("accuracy", "Accuracy against time", [*blocks, Fold("The presets measured", [table])])
