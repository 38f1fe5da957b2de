"""Which hyper-parameters the paper's rules choose on a sweep's scores, with candidates and reasons."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MEASURES", "candidate_tables", "papers_choice", "reasons"]

MEASURES = {"alpha": "AUC of what was found", "lambda": "mean adversarial loss"}
_PAPER = Path(__file__).resolve().parent.parent / "measured" / "paper_choices.json"
"""Copied from the paper's text: supplement, Hyper-Parameters."""


@functools.cache
def _paper() -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = json.loads(_PAPER.read_text())["chosen"]
    return found


def papers_choice(parameter: str, of: str) -> float | None:
    """What the paper chose for a mode (alpha) or a vehicle (lambda); None where it says nothing."""
    return _paper()[parameter].get(of)


def candidate_tables(choices: pd.DataFrame) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, header and lines of a table a parameter (and detector, accuracy, effects where there are several).

    choices: the table of ``final/``. A line is what was chosen for: a mode (alpha), or a vehicle (lambda).
    """
    several = [name for name in ("detector", "accuracy", "effects", "alpha") if choices[name].nunique() > 1]
    tables = []
    for parameter, rows in choices.groupby("parameter", sort=False):
        candidates = sorted(set(rows["candidate"]))
        lines = []
        for values, group in rows.groupby(["mode", "vehicle", "alpha", "detector", "accuracy", "effects"],
                                          sort=False, dropna=False):  # fmt: skip
            named = dict(zip(("mode", "vehicle", "alpha", "detector", "accuracy", "effects"), values))
            of = named["mode"] if parameter == "alpha" else named["vehicle"]
            said = [f"{name} {_short(named[name])}" for name in several if named[name] == named[name]]
            found = dict(zip(group["candidate"], group["found"]))
            paper = papers_choice(str(parameter), str(of))
            lines.append(
                [
                    ", ".join([str(of).replace("_", " "), *said]),
                    *(f"{found[value]:.3f}" if value in found else "-" for value in candidates),
                    f"{group.loc[group['chosen'], 'candidate'].iloc[0]:g}",
                    "-" if paper is None else f"{paper:g}",
                ]
            )
        header = ["", *(f"{parameter} {value:g}" for value in candidates), "chosen", "paper"]
        tables.append((f"Choice of {parameter}, by {MEASURES[str(parameter)]}", header, lines))
    return tables


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def reasons(choices: pd.DataFrame) -> list[str]:
    """Why each choice was made, a sentence each."""
    return list(dict.fromkeys(choices["why"]))
