"""``shift3d rules``: find properties common to the objects that the detector misses."""

from __future__ import annotations

import argparse

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command

_DESCRIPTION = """\
Says what the objects share that the detector misses: range, angle to the line of sight, tilt, length, width, height
and ground clearance. Shallow regression trees find a list of rules on every other scene and every other vehicle of a
finished sweep. A rule is about the objects that no rule above it holds for. Each rule is then tried on the other
scenes, on the other vehicles, and on the other detectors' scores. A rule holds where the score falls in all of these,
with 95 % confidence."""

_EPILOG = """\
examples:
  shift3d rules outputs/default-1a2b3c4d5e6f7a8b
  make sweep SWEEP=failure_rules               every kind of vehicle, no search, two detectors; size=small is shorter

Rules need scenes: 8 at least, 20 or more to hold. Sizes need naturalness (naturalness=wide, the default). Rules over
two detectors need detector.scored_by=null."""


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.results import read_sweep
    from shift3d.analysis.tables.failure_rules import failure_rules, left_out, rule_objects, rules_table

    objects = rule_objects(read_sweep(arguments.out))
    rules = failure_rules(objects)
    if rules:
        print(rules_table(rules))
    else:
        print("no rules: nothing that was measured tells objects with low scores from the others")
    if lacking := left_out(objects):
        print(lacking)
    return 0


COMMAND = Command("rules", "find what missed objects have in common", _DESCRIPTION, _EPILOG, _run, FINISHED_SWEEP_HELP)
