"""\
Runs the sweep NAME (default: default) and writes to outputs/NAME-<hash>/, or to out=DIR. DIR may be s3://BUCKET/PREFIX
or gs://BUCKET/PREFIX: workers then need no shared folder.
The same command resumes: finished tasks do not run again.

An override changes a setting (conf/ lists all settings) or selects an option of a group. Several values
separated by commas are an axis: the sweep runs every task with each value.

NAME is the file sweeps/NAME.yaml, an option vehicle=NAME of a group is conf/vehicle/NAME.yaml, and job=NAME is
jobs/NAME.yaml. shift3d looks in the current folder first, then among its shipped files: your own file replaces a
shipped file of the same name. A sweep of your own begins with `defaults: [/config, _self_]`, or with a shipped sweep in
place of /config.

examples:
  shift3d sweep                                  5 vehicles x 4 streets x (shape, pose)
  shift3d sweep default scenes.count=20          more streets
  shift3d sweep default vehicle=suv mode=shape attack.lambda=0.1,1,10
  shift3d sweep default accuracy=draft,standard  one more axis
  shift3d sweep default detector=sst             attack SST; PointPillars scores the solutions as well
  shift3d sweep kitti scenes.root=PATH out=runs/kitti
  shift3d sweep kitti scenes.root=PATH scenes.skip_bad=true      skip the frames that cannot be read
  shift3d sweep kitti scenes.root=PATH vehicle=deepsdf vehicle.folder=PATH vehicle.name=NAME,NAME
  shift3d sweep default out=s3://bucket/runs/a runner.address=auto
  shift3d sweep smoke runner=local tracking=none run in this process, write nothing but the folder
  shift3d sweep default job=ray_cluster out=s3://BUCKET/FOLDER  run on a cluster, see shift3d jobs
  shift3d sweep plan default scenes.count=20     show tasks, run time and core-hours; run nothing
  shift3d sweep default scenes.count=20 reuse=outputs/default-1a2b3c4d   of a larger grid, run only the new tasks
  shift3d sweep status outputs/default-1a2b3c4d  show the progress, from any shell or machine
  shift3d sweep outputs/default-1a2b3c4d         resume it; --retry-quarantined also runs its quarantined tasks again"""

from __future__ import annotations

import argparse
import shlex
from functools import partial
from typing import TYPE_CHECKING

from shift3d.cli.command import Command
from shift3d.cli.commands.plan import add_tasks, show, show_places
from shift3d.cli.completion import folder_words, sweep_words
from shift3d.cli.outcomes import interrupted, mirror
from shift3d.cli.sweep_arguments import SWEEP_METAVAR, SWEEP_WORDS, SweepRequest, read_words
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.analysis.results import Sweep
    from shift3d.settings.schema.config import Config
    from shift3d.store.location import Location
    from shift3d.sweep.drive import SweepResult
    from shift3d.sweep.planning.kind import TaskKind
    from shift3d.sweep.planning.plan import Plan


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--dry-run", action="store_true", help="show the plan and run nothing, like: sweep plan")
    add_tasks(parser, "with plan or --dry-run: ")
    parser.add_argument("--retry-quarantined", action="store_true", help="run quarantined tasks again")
    help_text = "copy the results of the same tasks from another sweep's folder; also reuse=OUT"
    reuse = parser.add_argument("--reuse", metavar="OUT", action="append", default=[], help=help_text)
    reuse.completer = folder_words  # type: ignore[attr-defined]
    parser.add_argument(
        "--task", metavar="ID", help="run only this task, in this process; print its rows or traceback, write nothing"
    )


def _run(arguments: argparse.Namespace) -> int:
    if arguments.words[:1] == ["status"]:
        return _status(arguments.words[1:])  # before the slow imports of a sweep: users poll the status
    from shift3d.processor import configure_runtime
    from shift3d.sweep.planning.kind import shift3d_kind

    configure_runtime()
    return run_with(arguments, shift3d_kind())


def run_with(arguments: argparse.Namespace, kind: TaskKind) -> int:
    """Run the sweep command for a kind of task."""
    from shift3d.analysis.forecast import expected, limit_line
    from shift3d.analysis.mlflow.store_uri import check_tracking
    from shift3d.settings.compose import compose_sweep
    from shift3d.store.resolve import as_location
    from shift3d.sweep.drive import run_single, run_sweep
    from shift3d.sweep.planning.folder import default_folder
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.sweep.planning.plan_view import plan_summary

    if arguments.words[:1] == ["status"]:
        return _status(arguments.words[1:])
    words = [*arguments.words, *(f"reuse={folder}" for folder in arguments.reuse)]
    if words[:1] == ["plan"] or arguments.dry_run:
        if arguments.task or arguments.retry_quarantined:
            raise InputError(
                "--task and --retry-quarantined run tasks, a plan runs none", remedy="Leave plan or --dry-run out"
            )
        return show(words[1:] if words[:1] == ["plan"] else words, kind, arguments.tasks, arguments.places)
    if arguments.tasks or arguments.places:
        raise InputError("--tasks and --places belong to a plan", remedy="Ask for one: shift3d sweep plan NAME --tasks")
    request = read_words(words)
    if request.job and request.job.address and not arguments.task:
        return _submit(request, request.job.address, arguments.retry_quarantined)
    if not arguments.task:  # before the scenes are read, which may take minutes
        (request.out or as_location("outputs")).check_writable("out=DIR")
    plan, config = make_plan(compose_sweep(request.name, request.overrides), kind.catalogue)
    check_tracking(config.tracking)
    folder = request.out or default_folder(plan)
    print(plan_summary(plan), flush=True)
    if arguments.task:
        print(run_single(plan, kind, arguments.task))
        return 0
    print(f"writing to {folder}", flush=True)
    if limit := limit_line(expected(plan.tasks, []).longest_s, config.runner):
        print(limit, flush=True)
    result = run_sweep(
        plan, config.runner, kind, folder, retry_quarantined=arguments.retry_quarantined, reuse=request.reuse
    )
    if result.reused:
        others = ", ".join(map(str, request.reuse))
        print(f"{result.reused} of {counted(result.planned, 'task')} copied from {others}")
    elif result.final is not None and not result.ran:
        print("nothing is left to run: these are the stored results")
    if result.final is None:
        flags = ["--retry-quarantined"] if arguments.retry_quarantined else []
        command = " ".join(shlex.quote(word) for word in ["shift3d", "sweep", *words, *flags])
        return interrupted(result, command=command)
    placed = _show(plan, config, result)
    return int(ExitCode.DONE if placed and not result.quarantined else ExitCode.INCOMPLETE)


def _submit(request: SweepRequest, address: str, retry_quarantined: bool) -> int:
    from shift3d.settings.folders import own_folders
    from shift3d.sweep.execution.ray.job import submit_sweep

    folders = [f"out={request.out}"] if request.out else []
    folders += [f"reuse={other}" for other in request.reuse]
    flags = ["--retry-quarantined"] if retry_quarantined else []
    environment = request.job.runtime_env if request.job else None
    return submit_sweep([request.name, *request.overrides, *folders, *flags], address, environment, own_folders())


def _status(words: list[str]) -> int:
    """Print the progress of a sweep. words: the sweep's output folder."""
    from shift3d.sweep.status import read_status, status_lines

    if len(words) != 1:
        raise InputError("which sweep?", where="sweep status", remedy="Name it: shift3d sweep status outputs/NAME-HASH")
    print(status_lines(read_status(words[0].removeprefix("out="))))
    return 0


def _show(plan: Plan, config: Config, result: SweepResult) -> bool:
    """Print the results of a sweep and mirror them to MLflow. Returns True if any vehicle found a place."""
    from shift3d.analysis.results import sweep_of
    from shift3d.analysis.tables.coverage import (
        coverage_lines,
        no_placement_message,
        small_sweep_warning,
        sweep_report,
        unresponsive_detectors,
    )
    from shift3d.analysis.tables.stability import stability_lines
    from shift3d.sweep.planning.plan_view import skipped_lines

    final = result.final
    assert final is not None
    sweep = sweep_of(plan, {name: final.frame(name) for name in final.tables}, environment={})
    unplaced = no_placement_message(sweep.scores, plan.settings)
    covered = "\n".join(coverage_lines(sweep.scores, sweep.attempts, result.planned))
    if unplaced:
        print(f"\n{unplaced}\n\n{covered}\n", flush=True)
        show_places(plan, config, most=5)
    elif sweep.scores.empty:
        print(f"\n{covered}\n", flush=True)
    else:
        for caveat in filter(None, (small_sweep_warning(plan), unresponsive_detectors(sweep.scores))):
            print(f"\n{caveat}")
        print(f"\n{sweep_report(sweep)}\n", flush=True)
        _show_effects(sweep, result.folder)
    for line in skipped_lines(plan):
        print(line)
    print(f"{result.folder / 'final'} written in {result.seconds:.0f} s")
    if unplaced or sweep.scores.empty:
        pass  # no solution to verify
    elif sweep.verification is not None:
        print(f"\n{stability_lines(sweep.verification)}\n")
    else:
        print(f"to check the hard cases for rounding errors: shift3d verify {shlex.quote(str(result.folder))}")
    _mirror(plan, config, result)
    return unplaced is None


def _show_effects(sweep: Sweep, folder: Location) -> None:
    """Print the impact of effects if the sweep ran the same tasks with and without effects."""
    variants = {request for group in sweep.plan.tasks.groups() for request in group.effects_requested}
    if "none" not in variants or len(variants) == 1:
        return
    from shift3d.analysis.html.sections.effects import write_effects_page
    from shift3d.analysis.tables.effects import effect_impacts, effect_milliseconds, effect_table

    try:
        impacts = effect_impacts(sweep.scores, effect_milliseconds(sweep.scores, sweep.timings))
    except InputError as error:
        print(f"nothing to compare: {error}\n")
        return
    page = write_effects_page(folder / "final" / "effects.html", sweep.plan.sweep, impacts)
    print(f"{effect_table(impacts)}\n\n{page}")


def _mirror(plan: Plan, config: Config, result: SweepResult) -> None:
    from shift3d.analysis.mlflow import sweep as mlflow_sweep
    from shift3d.analysis.results import natural_by_task, with_effects_requested

    assert result.final is not None
    counts: dict[str, float] = {
        "tasks_done": result.done,
        "tasks_quarantined": result.quarantined,
        "tasks_planned": result.planned,
    }
    if "verification" in result.final.tables:
        stable = result.final.frame("verification")["stable"]
        counts |= {"solutions_verified": len(stable), "solutions_unstable": int((~stable).sum())}
    if verdicts := natural_by_task(result.final.frame("scores")):
        counts |= {"shapes_measured": len(verdicts), "shapes_natural": sum(verdicts.values())}
    tables = {name: result.final.frame(name) for name in result.final.tables}
    if "retrieved" in tables:
        tables["retrieved"] = with_effects_requested(tables["retrieved"], plan.tasks)
    counts |= mlflow_sweep.follow_up_metrics(tables)
    settings = {"settings": plan.common_settings, "axes": plan.axes}
    auc, curves = result.final.frame("auc"), result.final.frame("curves")
    record = mlflow_sweep.SweepRecord(plan.sweep, plan.spec_hash, result.folder, settings, auc, curves, counts)
    mirror(config.tracking, partial(mlflow_sweep.mirror, record), f"{plan.sweep}-{plan.spec_hash}")


COMMAND = Command(
    "sweep",
    "run or resume a sweep",
    __doc__,
    _run,
    words=SWEEP_WORDS,
    metavar=SWEEP_METAVAR,
    complete=sweep_words,
    options=_options,
    resumes=True,
)
