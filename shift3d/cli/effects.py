"""``shift3d effects``: what each effect is worth, from a sweep that ran with and without it."""

from __future__ import annotations

import argparse
from pathlib import Path

from shift3d.cli.command import Command

__all__ = ["COMMAND"]

_DESCRIPTION = """\
How far does an effect move scores, and what does it cost? From the tables of a sweep that ran the same tasks
without effects and with one of them at a time (make sweep SWEEP=effects). Prints the table, writes
OUT/final/effects.html, and, with --adopt, what effects=auto goes by: an effect whose change of the score lies
below the bound with 95 % confidence is left out from then on, and the plan says so."""

_EPILOG = """\
examples:
  make sweep SWEEP=effects
  shift3d effects outputs/effects-1a2b3c4d5e6f7a8b
  shift3d effects outputs/effects-1a2b3c4d5e6f7a8b --adopt"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", metavar="OUT", type=Path, help="output folder of a finished sweep")
    parser.add_argument("--adopt", action="store_true", help="let effects=auto go by these numbers")


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.render.called_for import WORTH
    from shift3d.report.effects import effect_lines, effect_worths, write_effects_page, write_worth
    from shift3d.store.tables import read_table
    from shift3d.sweep.folder import read_plan

    folder = arguments.out.expanduser()
    sweep = read_plan(folder).sweep
    scores, timings = (
        read_table(folder / "final" / f"{name}.parquet", name).to_pandas() for name in ("scores", "timings")
    )
    worths = effect_worths(scores, timings)
    print(f"{effect_lines(worths)}\n")
    print(f"{write_effects_page(folder / 'final' / 'effects.html', sweep, worths)} written")
    if arguments.adopt:
        print(f"{write_worth(WORTH, sweep, worths)} written: effects=auto goes by it")
    return 0


COMMAND = Command("effects", "what each effect is worth", _DESCRIPTION, _EPILOG, _add_arguments, _run)
