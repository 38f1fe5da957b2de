"""The driver: plan, run what is left, commit, and write the final tables."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from shift3d.config.schema import LocalRunnerConfig, RayRunnerConfig
from shift3d.signals import stop_signals
from shift3d.store.log import Commit, CommitLog
from shift3d.sweep.commit import Committer
from shift3d.sweep.final import FinalTables, write_final
from shift3d.sweep.folder import open_folder
from shift3d.sweep.kind import TaskKind
from shift3d.sweep.plan import Plan, PlannedTask
from shift3d.sweep.progress import Progress
from shift3d.sweep.runner import Runner, make_runner

__all__ = ["SweepResult", "run_sweep"]

RunnerConfig = RayRunnerConfig | LocalRunnerConfig
Finish = Callable[[Path, Plan, Sequence[Commit]], FinalTables]


@dataclass(frozen=True)
class SweepResult:
    """How a sweep ended.

    final: None where it was interrupted. seconds: of this driver, planning excluded.
    """

    folder: Path
    final: FinalTables | None
    done: int
    quarantined: int
    planned: int
    seconds: float

    @property
    def interrupted(self) -> bool:
        """Whether tasks are left that were not tried."""
        return self.final is None


def run_sweep(
    plan: Plan, runner_config: RunnerConfig, kind: TaskKind, folder: Path, finish: Finish = write_final
) -> SweepResult:
    """Run what a plan has left to run, and write ``final/``.

    finish: writes the final tables from (folder, plan, log entries) when everything has run.

    The first Ctrl-C (or SIGTERM) lets the tasks in flight finish and commits them, the second one drops them.

    Raises:
        InputError: the folder is another sweep's, another driver took over, the disk is full, or the tasks'
            assets cannot be loaded. What was committed stays.
    """
    began = time.monotonic()
    open_folder(folder, plan)
    log = CommitLog(folder, plan.spec_hash)
    left = plan.tasks.select(plan.tasks.without(log.done() | log.quarantined()))
    if len(left):
        runner = make_runner(kind, plan, runner_config, len(left))
        try:
            with Progress(len(plan.tasks), len(plan.tasks) - len(left), runner.workers) as progress:
                _run(runner, left, Committer(log, runner_config.commit_seconds), progress)
        finally:
            runner.close()
    done, quarantined = log.done(), log.quarantined()
    complete = len(done) + len(quarantined) == len(plan.tasks)
    final = finish(folder, plan, log.entries) if complete else None
    seconds = time.monotonic() - began
    return SweepResult(folder, final, len(done), len(quarantined), len(plan.tasks), seconds)


def _run(runner: Runner, left: Sequence[PlannedTask], committer: Committer, progress: Progress) -> None:
    with _stop_on_signals(committer, progress) as stop:
        try:
            for outcome in runner.run(left, stop.first):
                committer.add(outcome)
                progress.update(len(outcome.done), len(outcome.quarantined))
                if outcome.fatal:
                    committer.flush()
                    raise outcome.fatal
                if stop.second.is_set():
                    break
        except KeyboardInterrupt:
            pass
        if stop.second.is_set():
            progress.say("dropping the tasks in flight")
        committer.flush()


@dataclass(frozen=True)
class _Stop:
    """first: give out no more tasks. second: do not wait for those in flight."""

    first: threading.Event
    second: threading.Event


@contextlib.contextmanager
def _stop_on_signals(committer: Committer, progress: Progress) -> Iterator[_Stop]:
    """Events that the first and the second SIGINT or SIGTERM set.

    The second one also raises KeyboardInterrupt, wherever that is: a task may take long. Only a commit is never
    cut short, since nobody could say afterwards whether it took place.
    """
    stop = _Stop(threading.Event(), threading.Event())

    def handle(number: int, frame: FrameType | None) -> None:
        if not stop.first.is_set():
            stop.first.set()
            progress.say("finishing the tasks in flight; again to drop them")
        elif not stop.second.is_set():
            stop.second.set()
            if not committer.busy:
                raise KeyboardInterrupt

    with stop_signals(handle):
        yield stop
