"""Hard cases of experiments in the original DeepSDF layout: specs.json, weights and codes."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from typing import Any

import torch
from catalogue import hard_case
from clear_errors import harmful, place, refused
from valid_weights import NETWORKS, write_experiment

from shift3d.sdf.deepsdf_checkpoint import load_deepsdf_checkpoint

AREA = "checkpoints"
WEIGHTS, CODES, SPECS = "ModelParameters/latest.pth", "LatentCodes/latest.pth", "specs.json"


def experiment_after(part: str, change: Callable[[Any], object]) -> Any:
    """Load the small experiment after a change of one of its three files, given as bytes or as its content."""
    with place() as folder:
        write_experiment(folder, next(iter(NETWORKS)))
        path = folder / part
        content = json.loads(path.read_text()) if part == SPECS else torch.load(path, weights_only=True)
        changed = change(content)
        if isinstance(changed, bytes):
            path.write_bytes(changed)
        elif part == SPECS:
            path.write_text(json.dumps(content))
        else:
            torch.save(content, path)
        return load_deepsdf_checkpoint(folder)


@hard_case(
    area=AREA,
    why="a checkpoint is a pickle, and a pickle can be a program",
    must="an error that names the file, and the program does not run",
    guard="only tensors and plain values are unpickled",
)
def a_checkpoint_that_runs_code() -> None:
    with place() as folder:
        marker = folder / "marker"
        refused(lambda: experiment_after(WEIGHTS, lambda content: harmful(marker)), "latest.pth")
        assert not marker.exists()


@hard_case(
    area=AREA,
    why="a damaged pickle fails in as many ways as it has instructions",
    must="an error that names the file",
    guard="whatever the unpickler raises becomes ours",
)
def a_checkpoint_that_is_torn() -> None:
    for content in (b"", b"PK\x03\x04 torn", b"\x80\x02}q\x00.", pickle.dumps(3)[:-1], b"\xff" * 100):
        refused(lambda content=content: experiment_after(CODES, lambda _: content), "latest.pth")


@hard_case(
    area=AREA,
    why="a network with another activation has the same tensors and other values",
    must="an error that names the file and the setting",
    guard="settings that the original network does not have are refused",
)
def specs_with_an_unknown_activation() -> None:
    for name in ("activation", "geometric_init", "positional_encoding"):
        change = lambda specs, name=name: specs["NetworkSpecs"].update({name: "elu"})  # noqa: E731
        refused(lambda change=change: experiment_after(SPECS, change), SPECS, name)


@hard_case(
    area=AREA,
    why='"false" in quotes is a text, and every text but the empty one counts as true',
    must="an error that names the file and the setting",
    guard="a switch must be true, false or null",
)
def specs_with_false_in_quotes() -> None:
    change = lambda specs: specs["NetworkSpecs"].update(use_tanh="false")  # noqa: E731
    refused(lambda: experiment_after(SPECS, change), SPECS, "use_tanh")


@hard_case(
    area=AREA,
    why="codes of another epoch fit in shape, and draw other cars",
    must="an error that names both epochs",
    guard="the epochs of codes and weights are compared",
)
def codes_of_another_epoch_than_the_weights() -> None:
    refused(
        lambda: experiment_after(CODES, lambda content: content.update(epoch=9)), "latest.pth", "epoch 9", "epoch 3"
    )


@hard_case(
    area=AREA,
    why="weight norm divides by a row's length: squares of 1e25 are infinite in float32, and the row would be zero",
    must="an error that names the file and the tensor",
    guard="the lengths must be finite",
)
def a_weight_norm_whose_squares_overflow() -> None:
    def spoil(content: Any) -> None:
        content["model_state_dict"]["module.lin1.weight_v"][0, 0] = 1e25

    refused(lambda: experiment_after(WEIGHTS, spoil), "latest.pth", "lin1.weight_v")
