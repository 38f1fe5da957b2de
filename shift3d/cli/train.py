"""``shift3d train``: the weights that ship."""

from __future__ import annotations

import argparse
from pathlib import Path

from shift3d.cli.command import Command, key_values
from shift3d.errors import InputError

__all__ = ["COMMAND"]

_EPILOG = """\
examples:
  shift3d train model=sdf
  shift3d train model=pointpillars                 an hour or so each on two cores
  shift3d train model=sdf out=DIR threads=1        the same command again resumes

pointpillars is trained on procedural streets, and on vehicles that the shipped sdf weights draw."""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "words", nargs="*", metavar="key=value", help="model=sdf or model=pointpillars, out=DIR, threads=N"
    )


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, ("model", "out", "threads"), ("model",), "train")
    threads = values.get("threads")
    if threads is not None and (not threads.isdigit() or int(threads) < 1):
        raise InputError(f"threads={threads!r} is not a number of threads", where="train", remedy="Give threads=2")
    from shift3d.training.command import train

    model = values["model"]
    out = Path(values.get("out", f"outputs/train-{model}")).expanduser()
    return train(model, out, int(threads) if threads else None)


COMMAND = Command(
    "train",
    "train the shipped weights again",
    "Trains a model from nothing but this package's own procedural data, and writes its weights.",
    _EPILOG,
    _add_arguments,
    _run,
)
