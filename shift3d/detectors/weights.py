"""Detectors by name, and their weight files."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from shift3d.detectors.anchor_detector import AnchorDetector
from shift3d.detectors.network import AnchorNet, Precision
from shift3d.detectors.pointpillars import PointPillarsNet
from shift3d.detectors.sst import SstNet
from shift3d.errors import InputError

__all__ = ["DETECTOR_NAMES", "NETWORKS", "load_detector", "load_network"]

WEIGHTS_FOLDER = Path(__file__).resolve().parent.parent / "weights"
NETWORKS: dict[str, type[PointPillarsNet] | type[SstNet]] = {"pointpillars": PointPillarsNet, "sst": SstNet}
DETECTOR_NAMES = tuple(NETWORKS)


def load_network(path: Path, name: str = "pointpillars") -> AnchorNet:
    """The trainable network with the weights of a safetensors file, in evaluation mode.

    Raises: InputError if the file is missing, unreadable, or holds another network's tensors.
    """
    if not path.is_file():
        raise InputError("the weight file does not exist", where=str(path), remedy=f'make train ARGS="model={name}"')
    try:
        state = load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(f"not a readable safetensors file: {error}", where=str(path)) from error
    net = NETWORKS[name]()
    expected = net.state_dict()
    for name in sorted(expected.keys() | state.keys()):
        found = tuple(state[name].shape) if name in state else None
        wanted = tuple(expected[name].shape) if name in expected else None
        if found != wanted:
            raise InputError(
                f"tensor {name} has shape {found}, the network has {wanted}",
                where=str(path),
                remedy="use weights trained for this version",
            )
    if not all(torch.isfinite(tensor).all() for tensor in state.values()):
        raise InputError("the weights are not all finite", where=str(path), remedy="train again")
    net.load_state_dict(state)
    return net.eval()


def load_detector(
    name: str = "pointpillars", path: Path | str | None = None, precision: Precision = "float32"
) -> AnchorDetector:
    """A detector by name with the shipped weights, or those of `path`.

    Raises: InputError for an unknown name or bad weights.
    """
    if name not in NETWORKS:
        raise InputError(f"unknown detector {name!r}", where="detector", remedy=f"known: {', '.join(DETECTOR_NAMES)}")
    file = Path(path) if path is not None else WEIGHTS_FOLDER / f"{name}.safetensors"
    return AnchorDetector(load_network(file, name), precision)
