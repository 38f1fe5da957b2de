"""\
Prints the number of tasks of a sweep, the effects that its scenes need with the cost of each, and the expected run
time. --tasks lists every task in order with its id. --places counts the places for a car in each scene, and the reasons
against the other places. Runs nothing. The same as: shift3d sweep plan.

The expected time of a task comes from the tasks that ran in timings=OUT, else in the sweep's own folder, else in
reuse=OUT; without any of these, from the shipped times. Tasks that the sweep's folder or reuse=OUT holds as
done do not count.

Task ids and the folder's name depend on the content of the scenes. If the plan would have to generate many streets for
these alone, it leaves them out; --tasks, reuse= and the sweep itself generate the streets and cache the result.

examples:
  shift3d plan default vehicle=suv scenes.count=2 --tasks
  shift3d plan default scenes.count=500 timings=outputs/default-1a2b3c4d runner.workers=64"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from shift3d.cli import sweep_arguments
from shift3d.cli.command import Command
from shift3d.cli.completion import plan_words
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.settings.schema.config import Config
    from shift3d.sweep.planning.kind import TaskKind
    from shift3d.sweep.planning.plan import Plan


def add_tasks(parser: argparse.ArgumentParser, when: str = "") -> None:
    """Add the options that list tasks and places. when: prefix of their help texts."""
    parser.add_argument("--tasks", action="store_true", help=f"{when}list every task with its id")
    parser.add_argument("--places", action="store_true", help=f"{when}count the places for a car in up to 20 scenes")


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.sweep.planning.kind import shift3d_kind

    return show(arguments.words, shift3d_kind(), arguments.tasks, arguments.places)


def show(sweep_words: Sequence[str], kind: TaskKind, tasks: bool = False, places: bool = False) -> int:
    """Print the plan of a sweep. Raises: InputError: the sweep command would refuse the words as well.

    sweep_words: words of the command. tasks: list every task. places: count the places of each scene.
    """
    from shift3d.analysis.forecast import run_time_lines
    from shift3d.analysis.mlflow.store_uri import check_tracking
    from shift3d.settings.compose import compose_sweep
    from shift3d.sweep.planning.folder import check_folder, default_folder
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.sweep.planning.plan_view import plan_lines, plan_summary
    from shift3d.sweep.planning.spec_file import read_spec

    timings, rest = sweep_arguments.pop_folders("timings", sweep_words)
    for other in timings:
        read_spec(other)  # refuses a folder that is not a sweep's, as read_words does for reuse=
    request = sweep_arguments.read_words(rest)
    if request.out:
        request.out.check_writable("out=DIR")
    begun = request.out is not None and (request.out / "spec.yaml").is_file()
    catalogue = kind.catalogue if tasks or begun or request.reuse else kind.preview or kind.catalogue
    plan, config = make_plan(compose_sweep(request.name, request.overrides), catalogue)
    check_tracking(config.tracking)
    print(plan_summary(plan), flush=True)
    folder = request.out or (None if plan.preview else default_folder(plan))
    if folder:
        folder.check_writable("out=DIR")
        check_folder(folder, plan)
    print(run_time_lines(plan, folder, request.reuse, timings, config.runner))
    unnamed = f"outputs/{plan.sweep}-HASH; the hash depends on the scenes: --tasks generates them and prints it"
    print(f"would write to {folder or unnamed}")
    for line in plan_lines(plan) if tasks else ():
        print(line)
    if places:
        show_places(plan, config)
    if not tasks:
        print("to list every task with its id: --tasks")
    return 0


def show_places(plan: Plan, config: Config, most: int = 20) -> None:
    """Count places for a car in up to `most` scenes, and the reasons against others, by the first task's settings."""
    from shift3d.settings.schema.scenes import scene_set
    from shift3d.task.places import place_lines

    scenes, where = scene_set(config.scenes), plan.tasks[0].spec.placement
    known = set(scenes.names())  # an axis may hold several scene sets
    names = [name for _, name in plan.tasks.scenes() if name in known]
    print(f"places for a car, {counted(where.attempts, 'draw')} per scene:")
    for line in place_lines(scenes, names, where, most):
        print(line, flush=True)
    if others := len(plan.tasks.scenes()) - len(names):
        print(f"  not counted: {counted(others, 'scene')} of other sets of an axis; give one set with scenes.KEY=VALUE")


COMMAND = Command(
    "plan",
    "show what a sweep would run",
    __doc__,
    _run,
    words=sweep_arguments.SWEEP_WORDS,
    metavar=sweep_arguments.SWEEP_METAVAR,
    complete=plan_words,
    options=add_tasks,
)
