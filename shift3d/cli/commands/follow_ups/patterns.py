"""\
Which changes of shape and pose do a sweep's attacks have in common? The command measures the mesh of every baseline and
of every adversarial shape of a finished sweep like a data sheet: length, width, height, clearance, bonnet, windshield,
overhangs. It prints the mean changes of these measures and of the poses with their intervals, and writes the measures
to OUT/final/patterns.parquet; the report shows them. The same command resumes.

examples:
  shift3d patterns outputs/default-1a2b3c4d5e6f7a8b                 on Ray, like the sweep
  shift3d patterns outputs/default-1a2b3c4d5e6f7a8b runner=local    in this process

A mesh takes about a second."""

from __future__ import annotations

import argparse
import shlex

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command
from shift3d.cli.outcomes import interrupted
from shift3d.cli.sweep_arguments import RUNNER_ARGUMENT, compose_runner
from shift3d.exit_codes import ExitCode


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.results import read_sweep
    from shift3d.analysis.tables.patterns import pattern_groups, patterns_table
    from shift3d.processor import configure_runtime
    from shift3d.sweep.follow_up import measure_patterns

    configure_runtime()
    result = measure_patterns(arguments.out, compose_runner(arguments.words, "patterns"))
    if result.final is None:
        return interrupted(result, "measured")
    sweep = read_sweep(arguments.out)
    for label, found in pattern_groups(sweep.patterns, sweep.scores):
        print(f"\n{patterns_table(f'Changes: {label}', found)}")
    print(f"\nmeasured in {result.seconds:.0f} s; shift3d report {shlex.quote(arguments.out)} shows the changes")
    print("the sweep's command copies them to MLflow")
    return int(ExitCode.INCOMPLETE if result.quarantined else ExitCode.DONE)


COMMAND = Command(
    "patterns",
    "measure how a sweep's attacks change shapes and poses",
    __doc__,
    _run,
    FINISHED_SWEEP_HELP,
    *RUNNER_ARGUMENT,
    resumes=True,
)
