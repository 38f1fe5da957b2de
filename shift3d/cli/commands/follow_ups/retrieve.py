"""\
Which labelled vehicles resemble the shapes that a sweep found, and does the detector miss them too? The command crops
every labelled vehicle of a set of scenes and fits a shape to its points in the decoder's first 10 principal components.
It puts the vehicle nearest to each adversarial shape in the place of that shape and scores it, as in the paper's
supplement. It does the same with up to three controls: vehicles seen from a similar distance with a similar number of
points. It writes the pool of vehicles to a separate folder, which other sweeps may use, and the result to OUT/final:
vehicle_pool.parquet and retrieved.parquet. The report shows both. The same command resumes.

examples:
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b                       vehicles of procedural streets (split val)
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b scenes.count=500      vehicles of more streets
  shift3d retrieve outputs/kitti-1a2b3c4d5e6f7a8b scenes=kitti scenes.root=PATH    labelled cars of KITTI frames
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b runner=local          in this process

The settings are those of sweeps/retrieval.yaml: the pool's scenes, the decoder (vehicle=), the detector that scores the
pool's vehicles where the scenes have them, the runner. The same settings use the same pool again. pool=DIR names the
pool's folder. The command refuses vehicles with fewer than 10 points and vehicles beyond the detector's grid. It flags
vehicles seen from one side only, vehicles that do not fit their box, and shapes without a surface; it never retrieves a
flagged vehicle."""

from __future__ import annotations

import argparse
import shlex

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command
from shift3d.cli.completion import retrieval_words
from shift3d.cli.outcomes import interrupted
from shift3d.cli.sweep_arguments import pop_folders
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.signals import received_signals
from shift3d.wording import counted


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.results import with_effects_requested
    from shift3d.analysis.tables.retrieval import pool_table, retrieval_table
    from shift3d.processor import configure_runtime
    from shift3d.settings.catalogue.reading import read_catalogue
    from shift3d.settings.compose import compose_sweep
    from shift3d.store.resolve import as_location
    from shift3d.sweep.follow_up import solved_tasks
    from shift3d.sweep.planning.folder import default_folder
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.sweep.retrieval import build_pool, check_decoders, other_detector, pool_plan, retrieve

    configure_runtime()
    folder = as_location(arguments.out)
    sweep = solved_tasks(folder)  # raises before any work if the sweep has not finished
    if all(group.template.mode == "pose" for group in sweep.tasks.groups()):
        what = "no task searched a shape: nothing to retrieve"
        raise InputError(what, str(folder), "Give a sweep of mode=shape or shape_pose")
    named, words = pop_folders("pool", arguments.words)
    made, config = make_plan(compose_sweep("retrieval", words), read_catalogue)
    plan = pool_plan(made)
    pool = named[-1] if named else default_folder(plan)
    check_decoders(sweep, plan, str(pool))
    if note := other_detector(sweep, plan):
        print(note)
    print(f"fitting the labelled vehicles of {counted(len(plan.tasks), 'scene')} into {pool}", flush=True)
    before = received_signals()
    fitted = build_pool(pool, plan, config.runner)
    if fitted.final is None or received_signals() > before:
        return interrupted(fitted)
    print(f"\n{pool_table(fitted.final.frame('vehicle_pool'))}\n", flush=True)
    scored = retrieve(folder, pool, config.runner)
    if scored.final is None:
        return interrupted(scored)
    table = retrieval_table(with_effects_requested(scored.final.frame("retrieved"), sweep.tasks))
    print(f"\n{table if table else 'no adversarial shape has a score: nothing to retrieve'}\n")
    print(f"{folder / 'final' / 'retrieved.parquet'} written in {fitted.seconds + scored.seconds:.0f} s")
    print(f"pictures and curves: shift3d report {shlex.quote(str(folder))}")
    print("the sweep's command copies the scores to MLflow")
    return int(ExitCode.INCOMPLETE if fitted.quarantined or scored.quarantined else ExitCode.DONE)


COMMAND = Command(
    "retrieve",
    "find labelled vehicles that resemble a sweep's shapes",
    __doc__,
    _run,
    FINISHED_SWEEP_HELP,
    "settings of sweeps/retrieval.yaml; pool=DIR",
    complete=retrieval_words,
    resumes=True,
)
