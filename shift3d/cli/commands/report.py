"""\
Writes OUT/report.html, one self-contained page: the result in short, the hard cases in 3D, 50 solutions drawn at random
over all tasks, AUC with bootstrap intervals beside the paper's, threshold-recall curves with bands, the places in the
bird's-eye view where the score falls, paired tests, stability, accuracy against run time, effects, and the settings,
cost and failures of the run.

examples:
  shift3d report outputs/default-1a2b3c4d5e6f7a8b
  shift3d report outputs/default-1a2b3c4d5e6f7a8b --cases 8

The command renders the hard cases again and draws the random ones, which takes about a minute. Run shift3d verify first
for the section on stability."""

from __future__ import annotations

import argparse

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command


def _options(parser: argparse.ArgumentParser) -> None:
    # A browser draws about 16 views in 3D at once, and each case has two.
    parser.add_argument(
        "--cases",
        metavar="N",
        type=int,
        choices=range(1, 9),
        default=4,
        help="number of hard cases to show (default 4)",
    )


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.html.report import write_report
    from shift3d.processor import configure_runtime

    configure_runtime()  # the same page on any machine
    path = write_report(arguments.out, arguments.cases)
    print(f"{path} written, {path.size() / 1e6:.1f} MB")
    return 0


COMMAND = Command(
    "report",
    "write the report page of a finished sweep",
    __doc__,
    _run,
    FINISHED_SWEEP_HELP,
    options=_options,
)
