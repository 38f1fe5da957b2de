"""``shift3d plan``: what a sweep would run."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from shift3d.cli import sweep
from shift3d.cli.command import Command

if TYPE_CHECKING:
    from shift3d.sweep.kind import TaskKind

__all__ = ["COMMAND", "show"]


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.sweep.kind import shift3d_kind

    return show(arguments.words, shift3d_kind())


def show(words: list[str], kind: TaskKind) -> int:
    """Print what a sweep of a kind of task would run."""
    from shift3d.cli.jobs import take_job
    from shift3d.sweep.folder import default_folder
    from shift3d.sweep.plan_view import plan_lines, plan_summary

    _, words = take_job(words)  # where it runs changes nothing of what runs
    _, words = sweep.take_folders("reuse", words)
    name, overrides, out = sweep.split_words(words)
    plan, _ = sweep.load_plan(name, overrides, kind)
    for line in plan_lines(plan):
        print(line)
    print(plan_summary(plan))
    print(f"would write to {out or default_folder(plan)}")
    return 0


COMMAND = Command(
    "plan",
    "show what a sweep would run",
    "Lists the tasks of a sweep, in order, with their ids, and runs nothing.",
    "example:\n  shift3d plan default vehicle=suv scenes.count=2",
    sweep.add_words,
    _run,
)
