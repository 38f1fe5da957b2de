"""\
Measures how far each effect moves scores and how long it takes, from the tables of a sweep that ran the same tasks
without effects and with one effect at a time (shift3d sweep effects). Prints the table and writes
OUT/final/effects.html. --adopt also writes the numbers that effects=auto uses: effects=auto then leaves out an effect
whose change of the score is below the bound with 95 % confidence, and the plan says so.

examples:
  shift3d sweep effects
  shift3d effects outputs/effects-1a2b3c4d5e6f7a8b
  shift3d effects outputs/effects-1a2b3c4d5e6f7a8b --times outputs/bench.json --adopt"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command
from shift3d.errors import InputError
from shift3d.wording import counted


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--times",
        metavar="FILE",
        type=Path,
        help='take the milliseconds from outputs/bench.json (make bench ARGS="-k effects")',
    )
    parser.add_argument("--adopt", action="store_true", help="make effects=auto use these numbers")


def _measured(path: Path) -> dict[str, float]:
    """Load milliseconds per effect from a benchmark's results. Raises: InputError: no readable effects in the file."""
    import json

    remedy = 'Make it: make bench ARGS="-k effects"'
    try:
        rows = json.loads(path.expanduser().read_text(encoding="utf-8"))
        measured = {name: float(row["value"]) for name, row in rows.items() if name.startswith("effect_")}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"cannot be read ({error})", where=str(path), remedy=remedy) from error
    if not measured:
        raise InputError("holds no times of effects", where=str(path), remedy=remedy)
    return {name.removeprefix("effect_").removesuffix("_ms"): value for name, value in measured.items()}


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.html.sections.effects import write_effects_page
    from shift3d.analysis.tables.effects import (
        LEAST_SCENES,
        effect_impacts,
        effect_milliseconds,
        effect_table,
        write_impact,
    )
    from shift3d.effects.applicability import MEASURED_IMPACT
    from shift3d.store.resolve import as_location
    from shift3d.store.tables import read_final
    from shift3d.sweep.planning.folder import read_plan

    folder = as_location(arguments.out)
    sweep = read_plan(folder).sweep
    scores, timings = (read_final(folder, name).to_pandas() for name in ("scores", "timings"))
    milliseconds = _measured(arguments.times) if arguments.times else effect_milliseconds(scores, timings)
    impacts = effect_impacts(scores, milliseconds)
    lacking = [impact.effect for impact in impacts if math.isnan(impact.milliseconds)]
    if lacking and (arguments.times or arguments.adopt):
        what, where = f"has no time of {', '.join(lacking)}, which the sweep ran", arguments.times or folder
        raise InputError(what, str(where), 'Measure every effect: make bench ARGS="-k effects"; give --times FILE')
    print(f"{effect_table(impacts)}\n")
    print(f"{write_effects_page(folder / 'final' / 'effects.html', sweep, impacts)} written")
    if arguments.adopt:
        if (fewest := min(impact.scenes for impact in impacts)) < LEAST_SCENES:
            what = f"{counted(fewest, 'scene')} behind an effect: intervals are too narrow below {LEAST_SCENES}"
            raise InputError(what, str(folder), f"Run the sweep with scenes.count={LEAST_SCENES} or more")
        print(f"{write_impact(MEASURED_IMPACT, sweep, impacts)} written: effects=auto uses it")
    return 0


COMMAND = Command("effects", "measure the impact of each effect", __doc__, _run, FINISHED_SWEEP_HELP, options=_options)
