"""What the sweep's accuracy was, what it cost, and what other presets would."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Items, Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy_cost import accuracy_cost, preset_table
from shift3d.analysis.tables.numerics import diagnostics

__all__ = ["accuracy"]


def accuracy(sweep: Sweep) -> Section:
    """The section: the audit of this sweep's own objects, and the presets as a frontier measured them."""
    audited = Items([*accuracy_cost(sweep.scores, sweep.timings), diagnostics(sweep.scores)])
    lead = Paragraph("Beams of each object are rendered again at reference accuracy.")
    return Section("accuracy", "Accuracy against time", [lead, audited, preset_table()])
