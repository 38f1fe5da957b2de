"""``shift3d plan``: what a sweep would run."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from shift3d.cli import sweep
from shift3d.cli.command import Command

if TYPE_CHECKING:
    from shift3d.sweep.kind import TaskKind

__all__ = ["COMMAND", "show"]


_DESCRIPTION = """\
Lists the tasks of a sweep, in order, with their ids; the effects that their scenes call for, with what each costs;
and how long it would take. Runs nothing. The same as: shift3d sweep plan.

The time a task takes is that of the sweep's own folder as far as it has run, or of timings=OUT; else the figures that
ship. What the folder has done already, or that of reuse=OUT, is not counted."""

_EPILOG = """\
examples:
  shift3d plan default vehicle=suv scenes.count=2
  shift3d plan default scenes.count=500 timings=outputs/default-1a2b3c4d runner.workers=64"""


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.sweep.kind import shift3d_kind

    return show(arguments.words, shift3d_kind())


def show(words: list[str], kind: TaskKind) -> int:
    """Print what a sweep of a kind of task would run."""
    from shift3d.cli.jobs import take_job
    from shift3d.config.schema import LocalRunnerConfig
    from shift3d.report.expected import expected_lines
    from shift3d.sweep.folder import default_folder
    from shift3d.sweep.plan_view import plan_lines, plan_summary

    _, words = take_job(words)  # where it runs changes nothing of what runs
    others, words = sweep.take_folders("reuse", words)
    timings, words = sweep.take_folders("timings", words)
    name, overrides, out = sweep.split_words(words)
    plan, config = sweep.load_plan(name, overrides, kind)
    for line in plan_lines(plan):
        print(line)
    print(plan_summary(plan))
    folder = out or default_folder(plan)
    workers = 1 if isinstance(config.runner, LocalRunnerConfig) else config.runner.workers or os.cpu_count() or 1
    print(expected_lines(plan, folder, others, timings, workers))
    print(f"would write to {folder}")
    return 0


COMMAND = Command(
    "plan",
    "show what a sweep would run",
    _DESCRIPTION,
    _EPILOG,
    sweep.add_words,
    _run,
)
