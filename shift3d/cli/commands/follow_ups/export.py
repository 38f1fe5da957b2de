"""``shift3d export``: write a solution of a finished sweep as files for other tools."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command, flag, key_values, whole_number, writable_folder
from shift3d.cli.completion import key_words
from shift3d.errors import InputError
from shift3d.methods import METHODS

if TYPE_CHECKING:
    from shift3d.store.location import Location

_KEYS = ("task", "method", "replicate", "to", "overwrite")
_VALUES = {"method": tuple(METHODS), "overwrite": ("true",)}

_HELP = f"""\
Writes one solution as files: the edited scene as KITTI scene.bin (points in the scene's order) and scene.ply, the mask
of the beams that hit the vehicle as hit_mask.npy, the vehicle as object.ply (metres, sensor frame) and object.glb (its
own frame, y up), boxes as box.json and boxes.json, and scene and boxes as a KITTI folder, kitti/training/ (velodyne,
calib, label_2).

example:
  shift3d export outputs/default-1a2b3c4d5e6f7a8b task=0f3a method=adversarial to=hard_case

task= is a task's id or its beginning; method= is one of
{", ".join(METHODS)}
(replicate= selects one of several, default 0). final/scores.parquet lists both. The command refuses a folder that
holds such files, unless overwrite=true. scenes=kitti scenes.root=DIR/kitti reads the KITTI folder, ground height
included; its calibration is that of a camera at the LiDAR's position."""


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, _KEYS, ("task", "method", "to"), "export")
    replicate = whole_number(values, "replicate", 0, "export", least=0)
    overwrite = flag(values, "overwrite", False, "export")
    from shift3d.store.resolve import as_location
    from shift3d.sweep.planning.folder import read_plan

    out = as_location(arguments.out)
    plan = read_plan(out)
    task = plan.tasks.one(values["task"], str(out))
    row = _solution(out, task.spec.task_id, values["method"], replicate)
    from shift3d.task.assets import load_assets
    from shift3d.task.follow_ups.export import check_no_export, export_solution

    target = writable_folder(values["to"], "to")
    if not overwrite:
        check_no_export(target)
    export_solution(task.spec, row, load_assets(plan.assets[task.assets]), target)
    print(f"{row.get('drawn_as') or task.spec.vehicle} in {task.spec.scene}, {values['method']}: {target}")
    return 0


def _solution(out: Location, task_id: str, method: str, replicate: int) -> dict[str, Any]:
    """Load a solution's row: latent_code, six pose columns, keys. Raises: InputError: no such method or replicate."""
    import pyarrow.compute as pc

    from shift3d.settings.messages import choice_error
    from shift3d.store.tables import read_final

    table, where = read_final(out, "solutions"), str(out / "final" / "solutions.parquet")
    rows = table.filter(pc.equal(table["task_id"], task_id)).to_pylist()
    found = {(row["method"], row["replicate"]): row for row in rows}
    if not found:
        raise InputError(f"task {task_id} has no solution", where, "See status in final/scores.parquet")
    methods = [row["method"] for row in rows]
    if method not in methods:
        raise choice_error("method", method, dict.fromkeys(methods), where)
    if (method, replicate) not in found:
        raise InputError(f"{method} has no replicate {replicate}", where, f"Give 0 to {methods.count(method) - 1}")
    return dict(found[method, replicate])


COMMAND = Command(
    "export",
    "write a solution's scene, mesh and box",
    _HELP,
    _run,
    FINISHED_SWEEP_HELP,
    "task=ID method=M to=DIR [replicate=N] [overwrite=true]",
    complete=key_words(_KEYS, _VALUES),
)
