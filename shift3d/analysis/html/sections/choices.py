"""Which hyper-parameters the paper's rules chose, from what, and why."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Fold, Items, Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.choices import choice_tables, reasons
from shift3d.sweep.results.hyperparameters import NEARLY_EQUAL

__all__ = ["choices"]

_TITLE = "Choice of hyper-parameters"
_RULE = (
    "The paper's rules: alpha by the lowest AUC of what the search found; lambda for each vehicle by the lowest mean "
    f"adversarial loss, the larger one of those within {NEARLY_EQUAL:.0%} of it (the paper says 'very similar' and no "
    "number). Over the scenes that have a score under every candidate."
)


def choices(sweep: Sweep) -> Section:
    """The section: a table a parameter, and a sentence a choice."""
    if sweep.choices.empty:
        text = "This sweep holds no two values of alpha or lambda."
        return Section("choices", _TITLE, [Paragraph(text, "missing")])
    why = Fold("Why each was chosen", [Items(reasons(sweep.choices))])
    return Section("choices", _TITLE, [Paragraph(_RULE), *choice_tables(sweep.choices), why])
