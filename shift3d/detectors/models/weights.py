"""Registry of networks by name, and loading of weight files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from shift3d.detectors.models.anchor_heads import WAYMO_ANCHORS
from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import PILLAR_NETWORKS
from shift3d.detectors.models.sst import SST_SMALL_SPEC, SstNet
from shift3d.errors import InputError

WEIGHTS_FOLDER = Path(__file__).resolve().parents[2] / "weights"
NETWORKS: dict[str, Callable[[], DetectorNet]] = {
    **{network.name: network for network in PILLAR_NETWORKS.values()},
    "sst": SstNet,
    "sst_small": partial(SstNet, SST_SMALL_SPEC),
}
ANCHOR_SIZE = "heads.anchor_size_m"
LARGEST_WEIGHT = 1e6
"""Bound on all values of a weight file. The largest trained value is a variance of 2,700, the largest weight 11. One
flipped exponent bit turns a weight into 1e38, which is finite but gives infinite scores."""


def load_network(path: Path, name: str = "pointpillars") -> DetectorNet:
    """Load a network by name with the weights of a safetensors file, trainable, in evaluation mode.

    Raises: InputError if the file is missing, or as `load_weights` does.
    """
    if not path.is_file():
        raise InputError("the weight file does not exist", str(path), f"Train it: shift3d train model={name}")
    return load_weights(NETWORKS[name](), path)


def load_weights(net: DetectorNet, path: Path) -> DetectorNet:
    """Load the weights of a safetensors file into a network, in place. Return the network in evaluation mode.

    Raises: InputError with file and tensor if the file is unreadable, or a tensor is missing, surplus, of another shape
        or number type, not finite, beyond LARGEST_WEIGHT, a negative variance, or an anchor size that is not positive.
    """
    try:
        state = load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        what = f"not a readable safetensors file: {error}"
        raise InputError(what, where=str(path), remedy="Copy it again") from error
    expected = net.state_dict()
    if ANCHOR_SIZE in expected:  # a file without anchor size was trained with the published size
        state.setdefault(ANCHOR_SIZE, torch.tensor(WAYMO_ANCHORS.size_m))
    for name in sorted(expected.keys() | state.keys()):
        found = tuple(state[name].shape) if name in state else None
        wanted = tuple(expected[name].shape) if name in expected else None
        if found != wanted:
            what = f"has shape {found}, the network has {wanted}"
            what = "is missing" if found is None else "is in no layer of the network" if wanted is None else what
            raise InputError(f"tensor {name} {what}", where=str(path), remedy=f"Give weights of {net.name}")
        if wrong := wrong_values(name, state[name], expected[name]):
            raise InputError(f"tensor {name} {wrong}", where=str(path), remedy="Copy it again, or train again")
    net.load_state_dict(state)
    return net.eval()


def wrong_values(name: str, found: Tensor, expected: Tensor) -> str:
    """Return why a tensor of the right shape cannot be a trained weight, or "". NaN fails every comparison."""
    if found.is_floating_point() != expected.is_floating_point() or found.is_complex():
        return f"is {str(found.dtype).removeprefix('torch.')}, not {str(expected.dtype).removeprefix('torch.')}"
    if not found.is_floating_point() or not found.numel():
        return ""
    found = found.float()  # torch has no maximum of eight-bit numbers
    if not float(found.abs().max()) <= LARGEST_WEIGHT:
        return f"holds values that are not finite, or beyond {LARGEST_WEIGHT:g}"
    if name == ANCHOR_SIZE and not float(found.min()) > 0.0:
        return "holds a size that is not positive"
    # The norm divides by the root of the variance; after folding, NaN would be in every score.
    return "holds a negative variance" if name.endswith("running_var") and float(found.min()) < 0.0 else ""
