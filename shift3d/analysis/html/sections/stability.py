"""Section and page of the stability and robustness of solutions, and section of the sweep's accuracy and its cost."""

from __future__ import annotations

import pandas as pd

from shift3d.analysis.figures.picture import png
from shift3d.analysis.figures.sweep import stability_figure
from shift3d.analysis.html.blocks import Block, Collapsible, Heading, Items, Paragraph, Picture, Section, Terms, missing
from shift3d.analysis.html.document import document, write_page
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy.cost import accuracy_cost, diagnostics, preset_meanings, preset_table
from shift3d.analysis.tables.stability import MEANINGS, stability_table, unstable_lines
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike
from shift3d.wording import counted


def accuracy(sweep: Sweep) -> list[Block]:
    """Build the section of accuracy: audit of the sweep's objects, and the presets as a frontier measured them."""
    audited = Items([*accuracy_cost(sweep.scores, sweep.timings), diagnostics(sweep.scores)])
    lead = Paragraph("The audit renders beams of each baseline and each solution again at reference accuracy.")
    explained = Collapsible("What the columns mean", [Terms(preset_meanings())])
    return [lead, audited, preset_table(), explained]


_ALT = (
    "Left: each solution's score at reference accuracy against the score that the sweep reported. Right: the smallest "
    "margin to the baseline under noise and pose offsets against the margin without them."
)


def stability(sweep: Sweep) -> list[Block]:
    """Build the section of stability, or one line if nothing was verified."""
    if sweep.solutions.empty:
        return [missing("No task has a solution.")]
    if sweep.verification is None or sweep.verification.empty:
        return [missing("Not verified. Run shift3d verify OUT to score every solution again at reference accuracy.")]
    return _blocks(sweep.verification, shown=20)


def write_stability_page(path: LocationLike, sweep: str, scores: pd.DataFrame, verification: pd.DataFrame) -> Location:
    """Write the page of one sweep's stability, with every unstable solution; the same tables give the same bytes.

    Raises: InputError: the disk is full or not writable.
    """
    section = Section("stability", "Solutions scored again", _blocks(verification, shown=None))
    return write_page(path, document(f"Stability of {sweep}", [section], diagnostics(scores)))


def _blocks(verification: pd.DataFrame, shown: int | None) -> list[Block]:
    """Build table, figure and list of unstable solutions. shown: maximum number to list; None: all."""
    unstable = int((~verification["stable"]).sum())
    listed: Block = Items(unstable_lines(verification, shown)) if unstable else Paragraph("None.")
    return [
        stability_table(verification),
        Picture(png(stability_figure(verification)), _ALT),
        Heading(counted(unstable, "unstable solution")),
        listed,
        Collapsible("What the columns mean", [Terms(MEANINGS)]),
    ]
