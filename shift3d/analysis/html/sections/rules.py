"""Section: what the objects share that the detector misses."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Block, Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.failure_rules import failure_rules, rules_objects, rules_table
from shift3d.errors import InputError

__all__ = ["rules"]

_LEAD = (
    "Rules that a shallow tree found on every other scene and every other vehicle. Each column shows the mean score of "
    "the objects that a rule holds for, less that of all others, on objects that it was not found on. A rule holds "
    "where all of these lie below zero with 95 % confidence. It says what goes together, not what causes it."
)


def rules(sweep: Sweep) -> Section:
    """The section; it says so where a sweep has too few scenes, or no rule."""
    blocks: list[Block]
    try:
        found = failure_rules(rules_objects(sweep))
    except InputError as error:
        blocks = [Paragraph(f"{error.what[:1].upper()}{error.what[1:]}.", "missing")]
    else:
        nothing = Paragraph("Nothing that was measured tells objects with low scores from the others.", "missing")
        blocks = [Paragraph(_LEAD), rules_table(found)] if found else [nothing]
    return Section("rules", "What the missed objects share", blocks)
