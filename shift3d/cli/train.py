"""``shift3d train``: the weights that ship, or a decoder of the user's own vehicles."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from shift3d.cli.command import Command, key_values
from shift3d.cli.mesh_words import FRAME_KEYS, FRAME_TEXT, mesh_frame, whole_number
from shift3d.errors import InputError

__all__ = ["COMMAND"]

_EPILOG = f"""\
examples:
  shift3d train model=sdf
  shift3d train model=pointpillars                 an hour or so each on two cores
  shift3d train model=sdf out=DIR threads=1        the same command again resumes

  shift3d train model=sdf vehicles=PATH length_m=4.5 out=DIR
                                                   a decoder of your own meshes and their codes, into DIR

pointpillars is trained on procedural streets, and on vehicles that the shipped sdf weights draw.

{FRAME_TEXT}"""

_MESH_KEYS = (*FRAME_KEYS, "steps")


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    text = "model=sdf or model=pointpillars, out=DIR, threads=N; model=sdf also: vehicles=PATH"
    parser.add_argument("words", nargs="*", metavar="key=value", help=f"{text}, {'=, '.join(_MESH_KEYS)}=")


def _run(arguments: argparse.Namespace) -> int:
    known = ("model", "out", "threads", "vehicles", *_MESH_KEYS)
    values = key_values(arguments.words, known, ("model",), "train")
    threads = whole_number(values, "threads", 2, "train") if "threads" in values else None
    if "vehicles" in values:
        return _train_on_meshes(values, threads)
    for key in _MESH_KEYS:
        if key in values:
            raise InputError(f"{key}= says something about vehicles=", where="train", remedy="Give vehicles=PATH too")
    from shift3d.training.command import train

    model = values["model"]
    out = Path(values.get("out", f"outputs/train-{model}")).expanduser()
    return train(model, out, threads)


def _train_on_meshes(values: dict[str, str], threads: int | None) -> int:
    """Train on meshes: everything goes to out=, the shipped weights stay as they are."""
    if values["model"] != "sdf":
        what = f"vehicles= is for model=sdf, not model={values['model']}"
        raise InputError(what, where="train", remedy="Give model=sdf")
    frame = mesh_frame(values, "train")
    from shift3d.training.sdf_on_meshes import STEPS, train_on_meshes

    out = Path(values.get("out", "outputs/train-vehicles")).expanduser()
    steps = whole_number(values, "steps", STEPS, "train")
    vehicles = train_on_meshes(values["vehicles"], frame, out, threads or os.cpu_count() or 1, steps)
    chamfer_cm = sorted(100.0 * vehicle.chamfer_m for vehicle in vehicles)
    print(
        f"{len(vehicles)} vehicles, decoder and codes in {out}/; symmetric Chamfer distance to their meshes: "
        f"median {chamfer_cm[len(chamfer_cm) // 2]:.2f} cm, worst {chamfer_cm[-1]:.2f} cm"
    )
    return 0


COMMAND = Command(
    "train",
    "train the shipped weights again",
    "Trains a model from nothing but this package's own procedural data, and writes its weights; or, given\n"
    "vehicles=, a decoder of the vehicles in mesh files.",
    _EPILOG,
    _add_arguments,
    _run,
)
