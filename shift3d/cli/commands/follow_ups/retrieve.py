"""``shift3d retrieve``: find labelled vehicles of a log that resemble a sweep's shapes."""

from __future__ import annotations

import argparse

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command
from shift3d.cli.completion import retrieval_words
from shift3d.cli.outcomes import interrupted
from shift3d.cli.sweep_arguments import pop_folders
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.signals import received_signals
from shift3d.wording import counted

_DESCRIPTION = """\
Which vehicles in a log are like the shapes that a sweep found, and are they missed too? Every labelled vehicle of a set
of scenes is cropped, and its shape is fitted to its points in the decoder's first 10 principal components. The vehicle
nearest to each adversarial shape is put in its place and scored, as in the paper's supplement. So are three controls:
vehicles that were seen from as far and by as many points. The pool goes to a folder of its own, which other sweeps may
use; the result goes to OUT/final: vehicle_pool.parquet and retrieved.parquet. The report shows both. The same command
again resumes."""

_EPILOG = """\
examples:
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b                       vehicles of procedural streets (split val)
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b scenes.count=500      of more of them
  shift3d retrieve outputs/kitti-1a2b3c4d5e6f7a8b scenes=kitti scenes.root=PATH    labelled cars of KITTI frames
  shift3d retrieve outputs/default-1a2b3c4d5e6f7a8b runner=local          in this process

Settings are those of sweeps/retrieval.yaml: the pool's scenes, the decoder (vehicle=), the detector that scores the
pool's vehicles where they stand, the runner. Without settings that change them, the same pool is used again.
pool=DIR names the pool's folder. Vehicles with fewer than 10 points are refused; those seen from one side, and those
that their box does not fit, are flagged and never retrieved."""


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.tables.retrieval import pool_table, retrieval_table
    from shift3d.processor import configure_runtime
    from shift3d.settings.catalogue.reading import read_catalogue
    from shift3d.settings.compose import compose_sweep
    from shift3d.store.resolve import as_location
    from shift3d.sweep.follow_up import solved_tasks
    from shift3d.sweep.planning.folder import default_folder
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.sweep.retrieval import build_pool, check_decoders, pool_plan, retrieve

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
    print(f"fitting the labelled vehicles of {counted(len(plan.tasks), 'scene')} into {pool}", flush=True)
    before = received_signals()
    fitted = build_pool(pool, plan, config.runner)
    if fitted.final is None or received_signals() > before:
        return interrupted(fitted)
    print(f"\n{pool_table(fitted.final.frame('vehicle_pool'))}\n", flush=True)
    scored = retrieve(folder, pool, config.runner)
    if scored.final is None:
        return interrupted(scored)
    table = retrieval_table(scored.final.frame("retrieved"))
    print(f"\n{table if table else 'no adversarial shape has a score: nothing to retrieve'}\n")
    print(f"{folder / 'final' / 'retrieved.parquet'} written in {fitted.seconds + scored.seconds:.0f} s")
    print(f"pictures and curves: shift3d report {folder}; the sweep's command again puts the scores into MLflow")
    return int(ExitCode.INCOMPLETE if fitted.quarantined or scored.quarantined else ExitCode.DONE)


COMMAND = Command(
    "retrieve",
    "find vehicles in scenes that are like a sweep's shapes",
    _DESCRIPTION,
    _EPILOG,
    _run,
    FINISHED_SWEEP_HELP,
    "settings of sweeps/retrieval.yaml; pool=DIR",
    complete=retrieval_words,
    resumes=True,
)
