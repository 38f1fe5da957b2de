"""\
Finds properties common to the objects that the detector misses: range, angle to the line of sight, tilt, length, width,
height and ground clearance. Shallow regression trees find a list of rules on every other scene and every other vehicle
of a finished sweep. A rule covers only objects that no earlier rule of the list matches. The command then tests each
rule on the other scenes, on the other vehicles, and on the other detectors' scores. A rule holds if the score falls in
all of these, with 95 % confidence.

examples:
  shift3d rules outputs/default-1a2b3c4d5e6f7a8b
  shift3d sweep failure_rules                  every kind of vehicle, no search, two detectors; size=small is shorter

Rules need at least 8 scenes, and 20 or more to hold. Rules on sizes need naturalness (naturalness=wide, the default).
Rules over two detectors need detector.scored_by=null."""

from __future__ import annotations

import argparse

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.results import read_sweep
    from shift3d.analysis.tables.failure_rules import failure_rules, left_out, rule_objects, rules_table

    objects = rule_objects(read_sweep(arguments.out))
    rules = failure_rules(objects)
    if rules:
        print(rules_table(rules))
    else:
        print("no rules: no measured property separates objects with low scores from the others")
    if lacking := left_out(objects):
        print(lacking)
    return 0


COMMAND = Command("rules", "find properties that missed objects share", __doc__, _run, FINISHED_SWEEP_HELP)
