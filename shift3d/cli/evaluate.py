"""``shift3d evaluate``: how good the shipped models are."""

from __future__ import annotations

import argparse

from shift3d.cli.command import Command, key_values
from shift3d.errors import InputError

__all__ = ["COMMAND"]

_EPILOG = """\
examples:
  shift3d evaluate model=pointpillars
  shift3d evaluate model=pointpillars kitti=PATH   PATH holds training/
  shift3d evaluate model=pointpillars scenes=20
  shift3d evaluate model=sdf"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "words", nargs="*", metavar="key=value", help="model=sdf or model=pointpillars, kitti=PATH, scenes=N"
    )


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, ("model", "kitti", "scenes"), ("model",), "evaluate")
    scenes = values.get("scenes", "200")
    if not scenes.isdigit() or int(scenes) < 1:
        raise InputError(f"scenes={scenes!r} is not a number of scenes", where="evaluate", remedy="Give scenes=200")
    from shift3d.training.command import evaluate

    return evaluate(values["model"], values.get("kitti"), int(scenes))


COMMAND = Command(
    "evaluate",
    "measure the shipped models",
    "Average precision of the detector on held-out scenes, or the shape model's distance to unseen vehicles.",
    _EPILOG,
    _add_arguments,
    _run,
)
