"""Sweep driver: run the remaining tasks of a plan, commit their results, and write the final tables."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.processor import configure_runtime, mixed_processors
from shift3d.progress_bar import write_line
from shift3d.settings.schema.config import RunnerConfig
from shift3d.signals import handle_stop_signals
from shift3d.store.location import Location
from shift3d.store.log import CommitLog, TakenOverError
from shift3d.store.log_entries import Commit
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.abort import AbortRule
from shift3d.sweep.execution.progress import Progress
from shift3d.sweep.execution.runner import Runner, make_runner
from shift3d.sweep.execution.worker import BatchOutcome, completed_rows
from shift3d.sweep.planning.folder import open_folder, read_environment
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.task_ids import read_task_scene
from shift3d.sweep.planning.tasks import Tasks, distinct_with_indices
from shift3d.sweep.results.commit import Committer
from shift3d.sweep.results.final import FinalTables, segments_in_plan_order, write_final
from shift3d.sweep.results.reuse import copy_finished_tasks
from shift3d.sweep.status import State, StatusWriter


def execution_order(tasks: Tasks, positions: np.ndarray) -> np.ndarray:
    """Order plan positions scene by scene, and pose before shape attacks, within each run of tasks of one vehicle.

    A pose attack takes about two thirds of a shape attack's time and makes no mesh, so the first result of a sweep
    comes sooner. Tasks of a vehicle stay together, and among these the tasks of a scene: a worker prepares each vehicle
    once, and measures its baseline in a scene once. Otherwise the plan order is kept.

    Args: positions: ascending.

    Source: our choice.
    """
    _, vehicle = distinct_with_indices(template.vehicle for template in tasks.templates)
    is_shape = np.array([template.mode == "shape" for template in tasks.templates], dtype=np.int64)
    template = tasks.template[positions]
    runs = np.cumsum(np.diff(vehicle[template], prepend=-1) != 0)
    # Scenes are numbered in plan order. Task scenes that differ only in their transfer scenes are one scene.
    _, number = distinct_with_indices(read_task_scene(text)[:2] for text in tasks.task_scenes.to_pylist())
    _, first, scene = np.unique(number[tasks.task_scene[positions]], return_index=True, return_inverse=True)
    return positions[np.lexsort((is_shape[template], first[scene], runs))]


Finish = Callable[[Location, Plan, Sequence[Commit]], FinalTables]


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep run.

    final: None if the run was interrupted. left: tasks that the same call would run again. seconds: of this driver,
    without planning. reused: tasks whose results were copied from other sweeps. ran: tasks that this driver ran.
    """

    folder: Location
    final: FinalTables | None
    done: int
    quarantined: int
    planned: int
    left: int
    seconds: float
    reused: int = 0
    ran: int = 0


def run_sweep(
    plan: Plan,
    runner_config: RunnerConfig,
    kind: TaskKind,
    folder: LocationLike,
    finish: Finish = write_final,
    retry_quarantined: bool = False,
    reuse: Sequence[LocationLike] = (),
) -> SweepResult:
    """Run the remaining tasks of a plan, and write ``final/``.

    finish: writes the final tables from (folder, plan, log entries) once all tasks have run. retry_quarantined: also
    run tasks that earlier runs quarantined. reuse: other sweeps' folders, whose results of the same tasks are first
    copied.

    The first Ctrl-C (or SIGTERM) lets the tasks in flight finish and commits them, the second one drops them.

    Raises:
        InputError: the folder belongs to another sweep, another driver took over, the disk is full, or the assets of
            the tasks cannot be loaded. Committed results stay.
        AbortedError: too many tasks failed.
    """
    began = time.monotonic()
    folder = as_location(folder)
    open_folder(folder, plan, kind.instructions)
    log = CommitLog(folder, plan.spec_hash)
    reused = sum(copy_finished_tasks(log, plan, other) for other in reuse)
    again = log.quarantined() if retry_quarantined else set()
    left = plan.tasks.without(log.finished() - again)
    if 0 < len(left) < len(plan.tasks) and not getattr(runner_config, "address", None):
        _note_processor(folder, kind.instructions())
    status = StatusWriter(log, len(left))
    status.write([], 0, "starting" if len(left) else "finished")
    came = 0
    if len(left):
        with (
            _runner(kind, plan, runner_config, left, _tried(log, plan, again), status) as runner,
            contextlib.closing(Progress(len(plan.tasks), len(plan.tasks) - len(left), runner.workers)) as progress,
        ):
            rule = AbortRule(runner_config.abort_after, runner_config.abort_share)
            committer = Committer(log, runner_config.commit_seconds)
            came = _run(runner, execution_order(plan.tasks, left), committer, progress, status, rule)
    done, quarantined = log.done(), log.quarantined()
    # A quarantined task that was to be retried, but was not, is still quarantined by the earlier run.
    complete = len(done) + len(quarantined) == len(plan.tasks) and (came >= len(left) or not again)
    final = finish(folder, plan, log.entries) if complete else None
    seconds = time.monotonic() - began
    left_now = len(plan.tasks) - len(done) - (0 if again else len(quarantined))
    return SweepResult(folder, final, len(done), len(quarantined), len(plan.tasks), left_now, seconds, reused, came)


def _note_processor(folder: Location, here: str) -> None:
    """Print one line if the sweep was begun on a processor that rounds otherwise. here: this one's instructions."""
    begun = read_environment(folder).get("instructions")
    if begun and begun != here:
        write_line(
            mixed_processors(f"this processor computes with {here}", f"the one that began the sweep with {begun}")
        )


@contextlib.contextmanager
def _runner(
    kind: TaskKind, plan: Plan, config: RunnerConfig, left: np.ndarray, tried: dict[int, int], status: StatusWriter
) -> Iterator[Runner]:
    """Prepare what the workers share, and yield the runner, which is closed at the end.

    If preparation or start fails, the status file says "stopped": no other process would report it.
    """
    try:
        if kind.prepare:
            for number, assets in enumerate(plan.assets):
                used = np.unique(plan.tasks.template[left][plan.tasks.assets[left] == number])
                kind.prepare(assets, [plan.tasks.templates[template] for template in used])
        runner = make_runner(kind, plan, config, len(left), tried)
    except BaseException:
        status.write([], 0, "stopped")
        raise
    try:
        yield runner
    finally:
        runner.close()


def _tried(log: CommitLog, plan: Plan, again: set[str]) -> dict[int, int]:
    """Return the earlier attempts of the tasks to retry, by position, so that attempt numbers continue."""
    if not again:
        return {}
    attempts = segments_in_plan_order(log.folder, log.entries, "attempts", plan)
    last = dict(zip(attempts["task_id"].to_pylist(), attempts["attempt"].to_pylist()))  # the last attempt wins
    found = pc.index_in(pa.array(sorted(again), type=pa.string()), value_set=plan.tasks.ids).to_pylist()
    return {position: last.get(task, 0) for task, position in zip(sorted(again), found) if position is not None}


def _run(
    runner: Runner, left: np.ndarray, committer: Committer, progress: Progress, status: StatusWriter, rule: AbortRule
) -> int:
    """Run tasks until all have an outcome or the user stops. Return their number. Raises AbortedError, InputError."""
    state: State = "stopped"
    came = 0
    failure: InputError | None = None
    stop = _Stop(progress)
    with handle_stop_signals(stop.handle):
        try:
            for outcome in stop.waited(runner.run(left, stop.first)):
                committer.add(outcome)
                ended, running = len(outcome.done) + len(outcome.quarantined), runner.running()
                came += ended
                progress.update(len(outcome.done), len(outcome.quarantined), running, runner.workers)
                status.finished(ended, outcome.peak_mb)
                status.left_out(runner.left_out)
                status.write(running, runner.workers)
                if error := outcome.fatal or rule.seen(outcome):
                    raise error
                if stop.second.is_set():
                    break
            state = "interrupted" if stop.first.is_set() else "finished"
        except KeyboardInterrupt:
            state = "interrupted"
        except TakenOverError:
            raise  # the other driver writes the status
        except InputError as error:
            failure = error
        if stop.second.is_set() and failure is None:
            progress.say("dropping the tasks in flight")
        try:
            committer.flush(stop.second.is_set)
        except TakenOverError:
            raise
        except InputError:
            status.write([], runner.workers, "stopped")
            raise
        status.write([], runner.workers, state)
    if failure is not None:
        raise failure
    return came


def run_single(plan: Plan, kind: TaskKind, task_id: str) -> str:
    """Run the task whose id begins with ``task_id``, and return its scores and timings as text.

    Raises: InputError: no task of the plan, or several, match. Exceptions of the task pass through.
    """
    task = plan.tasks.one(task_id, f"sweep {plan.sweep}")
    planned = plan.assets[task.assets]
    assets = kind.load(planned)
    configure_runtime(planned.threads)
    rows = completed_rows(task.spec, plan.sweep, kind.run(task.spec, assets))
    parts = []
    for name in ("scores", "timings"):
        frame = table_from_rows(name, rows[name]).to_pandas()
        parts.append(frame.drop(columns=["task_id", "sweep"], errors="ignore").to_string())
    return "\n\n".join(parts)


class _Stop:
    """Stop requests from SIGINT and SIGTERM. first: give out no more tasks. second: drop the tasks in flight."""

    def __init__(self, progress: Progress) -> None:
        self.first, self.second = threading.Event(), threading.Event()
        self._progress = progress
        self._waits = False

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Count a signal; the second raises KeyboardInterrupt during a wait for the runner, as a task may take long.

        A commit is never interrupted, since nobody could tell afterwards whether it took place.
        """
        if not self.first.is_set():
            self.first.set()
            self._progress.say("finishing the tasks in flight; a second Ctrl-C drops them")
        elif not self.second.is_set():
            self.second.set()
            if self._waits:
                raise KeyboardInterrupt

    def waited(self, outcomes: Iterator[BatchOutcome]) -> Iterator[BatchOutcome]:
        """Yield the same outcomes. A wait for the next one may raise KeyboardInterrupt."""
        while True:
            self._waits = True
            try:
                outcome = next(outcomes, None)
            finally:
                self._waits = False
            if outcome is None:
                return
            yield outcome
