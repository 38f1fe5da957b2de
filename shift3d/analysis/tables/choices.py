"""Hyper-parameters that the paper's rules choose from a sweep's scores, with candidates and reasons."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import setting_text

MEASURES = {"alpha": "AUC of the solutions", "lambda": "mean adversarial loss"}
# Copied from the paper's text: supplement, Hyper-Parameters.
_PAPER = Path(__file__).resolve().parents[1] / "measured" / "paper_choices.json"
_OF = ("mode", "vehicle", "detector", "accuracy", "search", "effects", "alpha")


def papers_choice(parameter: str, of: str) -> float | None:
    """Return the paper's choice for a mode (alpha) or a vehicle (lambda), or None if the paper gives none."""
    chosen: dict[str, dict[str, float]] = json.loads(_PAPER.read_text(encoding="utf-8"))["chosen"]
    return chosen[parameter].get(of)


def choice_tables(choices: pd.DataFrame) -> list[Table]:
    """Build a table per parameter, a line per mode (alpha) or vehicle (lambda) and setting. choices: of ``final/``."""
    tables = []
    for parameter, rows in choices.groupby("parameter", sort=False):
        candidates = sorted(set(rows["candidate"]))
        own = "mode" if parameter == "alpha" else "vehicle"
        several = [name for name in _OF if name != own and rows[name].nunique() > 1]
        lines = []
        for values, group in rows.groupby(list(_OF), sort=False, dropna=False):
            named = dict(zip(_OF, values))
            of = str(named[own])
            settings = [f"{name} {setting_text(named[name])}" for name in several if named[name] == named[name]]
            found = dict(zip(group["candidate"], group["found"]))
            paper = papers_choice(str(parameter), of)
            each = [f"{found[value]:.3f}" if value in found else "-" for value in candidates]
            chosen = f"{group.loc[group['chosen'], 'candidate'].iloc[0]:g}"
            name = ", ".join([of.replace("_", " "), *settings])
            lines.append([name, *each, chosen, "-" if paper is None else f"{paper:g}"])
        header = ["", *(f"{parameter} {value:g}" for value in candidates), "chosen", "paper"]
        tables.append(Table(f"Choice of {parameter}, by {MEASURES[str(parameter)]}", header, lines))
    return tables


def reasons(choices: pd.DataFrame) -> list[str]:
    """Return the reason of each choice, one sentence each."""
    return list(dict.fromkeys(choices["why"]))
