"""Which hyper-parameters the paper's rules chose, from what, and why."""

from __future__ import annotations

from shift3d.report.choices import candidate_tables, reasons
from shift3d.report.html.document import Section, escape, paragraph, table
from shift3d.report.html.sweep import Sweep
from shift3d.sweep.results.hyperparameters import NEARLY_EQUAL

__all__ = ["choices"]

_TITLE = "Choice of hyper-parameters"


def choices(sweep: Sweep) -> Section:
    """The section: a table a parameter, and a sentence a choice."""
    if sweep.choices.empty:
        return Section("choices", _TITLE, [paragraph("This sweep holds no two values of alpha or lambda.", "missing")])
    rule = (
        "The paper's rules: alpha by the lowest AUC of what the search found; lambda for each vehicle by the lowest "
        f"mean adversarial loss, the larger one of those within {NEARLY_EQUAL:.0%} of it (the paper says 'very "
        "similar' and no number). Over the scenes that have a score under every candidate."
    )
    tables = [table(title, header, lines) for title, header, lines in candidate_tables(sweep.choices)]
    said = "".join(f"<li>{escape(why)}</li>" for why in reasons(sweep.choices))
    return Section("choices", _TITLE, [paragraph(rule), *tables, f"<ul>{said}</ul>"])
