"""``shift3d train``: the weights that ship."""

from __future__ import annotations

import argparse

from shift3d.cli.command import Command, key_values

__all__ = ["COMMAND"]

_EPILOG = """\
examples:
  shift3d train model=sdf
  shift3d train model=pointpillars"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("words", nargs="*", metavar="key=value", help="model=sdf or model=pointpillars")


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, ("model",), ("model",), "train")
    from shift3d.training.command import train

    return train(values["model"])


COMMAND = Command(
    "train",
    "train the shipped weights again",
    "Trains a model from nothing but this package's own procedural data, and writes its weights.",
    _EPILOG,
    _add_arguments,
    _run,
)
