"""What a training starts from: weights of the same detector, of a smaller one, or another's encoder and backbone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from shift3d.detectors.models.sst import SstNet, SstSpec
from shift3d.detectors.models.weights import ANCHOR_SIZE, WEIGHTS_FOLDER, load_network
from shift3d.training.detector.growing import grown
from shift3d.training.detector.recipe import Recipe

HEADS = "heads."


def start_file(recipe: Recipe, start_from: Path | None) -> Path | None:
    """The weights file that a training starts from, None where it begins with random weights."""
    if start_from is not None:
        return start_from
    name = recipe.grown_from or recipe.backbone_from
    return WEIGHTS_FOLDER / f"{name}.safetensors" if name else None


def start_state(recipe: Recipe, start_from: Path | None) -> Mapping[str, Tensor] | None:
    """The state dict that training starts from, None for random weights.

    start_from: weights of the recipe's own detector; None: what the recipe names.
    Raises: InputError for missing or bad weights.
    """
    if start_from is not None:
        return _own_anchors(load_network(start_from, recipe.detector).state_dict(), recipe)
    file = start_file(recipe, None)
    if file is None:
        return None
    if recipe.grown_from:
        small = load_network(file, recipe.grown_from)
        assert isinstance(small, SstNet) and isinstance(recipe.network, SstSpec)
        return _own_anchors(grown(small.state_dict(), small.spec, recipe.network, recipe.seed), recipe)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(recipe.seed)
        state = dict(recipe.new_network().state_dict())
    other = load_network(file, recipe.backbone_from).state_dict()
    return state | {name: tensor for name, tensor in other.items() if not name.startswith(HEADS)}


def _own_anchors(state: Mapping[str, Tensor], recipe: Recipe) -> dict[str, Tensor]:
    return with_anchor_size(state, recipe.anchor_size_m) if ANCHOR_SIZE in state else dict(state)


def with_anchor_size(state: Mapping[str, Tensor], size_m: tuple[float, float, float]) -> dict[str, Tensor]:
    """The state dict of an anchor detector that draws the same boxes against anchors of another size.

    Codes are linear in the features, and codes against one anchor are linear in those against another: see
    `box_coding`. In float64, to the rounding of float32.
    """
    old, new = state[ANCHOR_SIZE].double(), torch.tensor(size_m, dtype=torch.float64)
    across = torch.hypot(old[0], old[1]) / torch.hypot(new[0], new[1])
    gain = torch.tensor((across, across, old[2] / new[2], 1.0, 1.0, 1.0, 1.0), dtype=torch.float64)
    higher = (old[2] - new[2]) / 2.0 / new[2]  # anchors stand on the ground: their centres differ by half of that
    shift = torch.tensor((0.0, 0.0, higher, *torch.log(old / new), 0.0), dtype=torch.float64)
    weight, bias = state["heads.boxes.weight"].double(), state["heads.boxes.bias"].double()
    anchors = len(bias) // len(gain)
    gain, shift = gain.repeat(anchors), shift.repeat(anchors)
    return {
        **state,
        ANCHOR_SIZE: new.float(),
        "heads.boxes.weight": (weight * gain.view(-1, 1, 1, 1)).float(),
        "heads.boxes.bias": (bias * gain + shift).float(),
    }
