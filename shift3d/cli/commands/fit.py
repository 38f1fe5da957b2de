"""``shift3d fit``: make vehicles for sweeps from the user's meshes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from shift3d.cli.command import Command, key_values, whole_number, writable_folder
from shift3d.cli.completion import key_words
from shift3d.cli.mesh_arguments import FRAME_KEYS, FRAME_TEXT, FRAME_VALUES, mesh_frame
from shift3d.exit_codes import ExitCode
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.vehicles.fit import MeshFit
    from shift3d.vehicles.mesh_frame import MeshFrame

_KEYS = ("out", "decoder", "steps", *FRAME_KEYS)

_HELP = f"""\
Finds the latent code whose decoded shape fits each mesh best, with the shipped decoder or decoder=FILE. Writes a
vehicle set to out=: vehicles.safetensors, its decoder sdf.safetensors, sdf.json (the repairs, and the distance of each
decoded shape from its mesh in centimetres) and pictures/ (each mesh beside its decoded shape). Warns if a mesh fits
better in another orientation, and if a vehicle is far from its mesh (exit code 3). The same command resumes: DIR/kept
holds every fitted or refused mesh, and vehicles.safetensors is written last.

examples:
  shift3d fit car.glb forward=+z unit=m out=outputs/my-car
  shift3d fit ShapeNetCore.v2/02958343 length_m=4.5 out=outputs/shapenet
  shift3d fit car.ply length_m=4.5 decoder=DIR/sdf.safetensors out=outputs/my-car
  shift3d sweep smoke vehicle=set vehicle.folder=outputs/my-car vehicle.name=car

{FRAME_TEXT}
A decoder draws only shapes like its training data: shift3d train model=sdf vehicles=PATH trains one on your meshes."""


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, _KEYS, ("out",), "fit")
    frame = mesh_frame(values, "fit")
    from shift3d.vehicles.fit import STEPS, fit_meshes

    out = writable_folder(values["out"])
    steps = whole_number(values, "steps", STEPS, "fit")
    fits = fit_meshes(arguments.path, frame, out, values.get("decoder"), steps)
    for fit in fits:
        size = " x ".join(f"{metres:.2f}" for metres in fit.vehicle.facts()["size_m"])
        print(f"{fit.vehicle.name}: {size} m, {100 * fit.vehicle.chamfer_m:.1f} cm from its mesh on average")
        if not fit.repair.watertight:
            print(f"{fit.vehicle.name}: mesh {fit.repair}")
        for doubt in _doubts(fit, frame, out):
            print(f"warning: {fit.vehicle.name}: {doubt}", file=sys.stderr)
    print(f"{counted(len(fits), 'vehicle')} in {out}/")
    return int(ExitCode.INCOMPLETE if any(fit.far for fit in fits) else ExitCode.DONE)


def _doubts(fit: MeshFit, frame: MeshFrame, out: Path) -> list[str]:
    """Return warnings that the user should check before a sweep inserts the vehicle."""
    doubts = []
    if fit.better:
        other, chamfer_m = fit.better
        keys = [key for key in ("forward", "up") if getattr(other, key) != getattr(frame, key)]
        words = " ".join(f"{key}={getattr(other, key)}" for key in keys)
        doubts.append(f"fits better with {words}: {100 * chamfer_m:.1f} cm")
    if fit.far:
        usual = f"{100 * fit.typical_chamfer_m:.1f} cm is usual for a car of this length"
        why = "perhaps because of its orientation" if fit.better else "the decoder cannot draw it"
        doubts.append(f"far from its mesh ({usual}), {why}: see {out / fit.picture}")
    return doubts


COMMAND = Command(
    "fit",
    "make vehicles from your own meshes",
    _HELP,
    _run,
    words=f"out=DIR decoder=FILE steps=N {'= '.join(FRAME_KEYS)}=",
    complete=key_words(_KEYS, FRAME_VALUES),
    resumes=True,
    options=lambda parser: parser.add_argument("path", metavar="PATH", help="a mesh, or a folder of meshes"),
)
