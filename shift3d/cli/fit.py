"""``shift3d fit``: vehicles of the user's own, from meshes, for sweeps."""

from __future__ import annotations

import argparse

from shift3d.cli.command import Command, key_values, writable_folder
from shift3d.cli.mesh_words import FRAME_KEYS, FRAME_TEXT, mesh_frame, whole_number
from shift3d.wording import counted

__all__ = ["COMMAND"]

_DESCRIPTION = """\
Finds the latent code that draws each mesh best, with the shipped decoder or decoder=FILE, and writes a vehicle
set to out=: vehicles.safetensors, its decoder sdf.safetensors, sdf.json (what was repaired, and how many
centimetres each code is off) and pictures/, each mesh beside what the decoder makes of it."""

_EPILOG = f"""\
examples:
  shift3d fit car.glb forward=+z unit=m out=outputs/my-car
  shift3d fit ShapeNetCore.v2/02958343 length_m=4.5 out=outputs/shapenet
  shift3d fit car.ply length_m=4.5 decoder=DIR/sdf.safetensors out=outputs/my-car
  shift3d sweep smoke vehicle=set vehicle.folder=outputs/my-car vehicle.name=car

{FRAME_TEXT}
A decoder draws what it was trained on: shift3d train model=sdf vehicles=PATH trains one on your meshes."""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="PATH", help="a mesh, or a folder of meshes")
    text = f"out=DIR decoder=FILE steps=N {'= '.join(FRAME_KEYS)}="
    parser.add_argument("words", nargs="*", metavar="key=value", help=text)


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, ("out", "decoder", "steps", *FRAME_KEYS), ("out",), "fit")
    frame = mesh_frame(values, "fit")
    from shift3d.vehicles.fit import STEPS, fit_meshes

    out = writable_folder(values["out"])
    steps = whole_number(values, "steps", STEPS, "fit")
    vehicles = fit_meshes(arguments.path, frame, out, values.get("decoder"), steps)
    for vehicle in vehicles:
        size = " x ".join(f"{metres:.2f}" for metres in vehicle.facts()["size_m"])
        print(f"{vehicle.name}: {size} m, {100 * vehicle.chamfer_m:.1f} cm from its mesh")
    print(f"{counted(len(vehicles), 'vehicle')} in {out}/")
    return 0


COMMAND = Command("fit", "vehicles from your own meshes", _DESCRIPTION, _EPILOG, _add_arguments, _run)
