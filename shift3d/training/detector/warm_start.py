"""Start weights of a training: of the same detector, of a smaller one, or another's encoder and backbone.

`grown` makes SST at its published size from trained weights of half the width and depth; both compute nearly the same.

Twelve layers, each followed by a norm, learn slowly from random weights: 4,750 steps (40 minutes on two cores) reached
the class loss that the small network had after 1,400. A grown network begins where the small one ended.

Source: Net2Net (Chen et al. 2016): every channel is duplicated, and the layer that reads it divides its weight between
the duplicates in random shares, so that they diverge in training. New layers between add nothing at first, because
their out and narrow weights are zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from shift3d.detectors.models.sst import SstNet, SstSpec
from shift3d.detectors.models.weights import ANCHOR_SIZE, WEIGHTS_FOLDER, load_network
from shift3d.training.detector.recipe import Recipe

_LEAST_SHARE = 0.3
_NORMS = ("norm_attention", "norm_feed_forward")
HEADS = "heads."


def start_file(recipe: Recipe, start_from: Path | None) -> Path | None:
    """Return the weights file that a training starts from; None for random weights."""
    if start_from is not None:
        return start_from
    name = recipe.grown_from or recipe.backbone_from
    return WEIGHTS_FOLDER / f"{name}.safetensors" if name else None


def start_state(recipe: Recipe, start_from: Path | None) -> Mapping[str, Tensor] | None:
    """Return the state dict that training starts from; None for random weights.

    start_from: weights of the recipe's own detector; None: the start that the recipe names.
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
    """Convert the state dict of an anchor detector to anchors of another size; the predicted boxes stay the same.

    Codes are linear in the features, and codes against one anchor are linear in codes against another: see
    `anchor_heads`. Computed in float64; exact to the rounding of float32.
    """
    old, new = state[ANCHOR_SIZE].double(), torch.tensor(size_m, dtype=torch.float64)
    across = torch.hypot(old[0], old[1]) / torch.hypot(new[0], new[1])
    gain = torch.tensor((across, across, old[2] / new[2], 1.0, 1.0, 1.0, 1.0), dtype=torch.float64)
    higher = (old[2] - new[2]) / 2.0 / new[2]  # anchors stand on the ground: centres differ by half the height
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


def doubled(spec: SstSpec, name: str) -> SstSpec:
    """Return the spec with twice the width, heads, blocks and channels."""
    twice = {size: 2 * getattr(spec.transformer, size) for size in ("width", "heads", "feed_forward", "blocks")}
    hidden, channels = 2 * spec.encoder_hidden, 2 * spec.out_channels
    transformer = replace(spec.transformer, **twice)
    return replace(spec, transformer=transformer, encoder_hidden=hidden, out_channels=channels, name=name)


def grown(small: Mapping[str, Tensor], spec: SstSpec, to: SstSpec, seed: int = 0) -> dict[str, Tensor]:
    """Build the state dict of a network of twice the sizes that computes nearly what the small network does.

    Args:
        small: the state dict of a network of sizes `spec`. to: `doubled` sizes. seed: of shares and new layers.
    Not exact: the norms of a new layer approximate the identity by the mean and size of the preceding norm's output,
    which differ from token to token.
    Raises: ValueError for sizes that are not twice those of spec.
    """
    if to != doubled(spec, to.name):
        raise ValueError(f"{to} is not twice {spec}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        state = SstNet(to).state_dict()
    draw = torch.Generator().manual_seed(seed)
    width = spec.transformer.width
    token, heads = _token_duplicates(width), _head_duplicates(width, spec.transformer.heads)
    by_code = torch.arange(2 * width) % 4 < 2  # the duplicate at the small network's position code

    def wide(name: str, rows: Tensor | None, columns: Tensor | None = None, first_only: Tensor | None = None) -> Tensor:
        tensor = small[name]
        tensor = tensor if rows is None else tensor[rows]
        return tensor if columns is None else _shared(tensor, columns, draw, first_only)

    hidden = _duplicates(spec.encoder_hidden)
    state |= {"encoder.first.weight": wide("encoder.first.weight", hidden)}
    both = torch.cat((hidden, hidden + spec.encoder_hidden))  # features of each point, and its pillar's maximum
    state |= {"encoder.second.weight": wide("encoder.second.weight", token, both)}
    state |= _norm(small, "encoder.first_norm", hidden) | _norm(small, "encoder.second_norm", token)
    forward = _duplicates(spec.transformer.feed_forward)
    query_key = torch.cat((heads, heads + width))
    for layer in range(2 * spec.transformer.blocks):
        ours, theirs = f"transformer.layers.{layer}.", f"transformer.layers.{layer // 2 * 4 + layer % 2}."
        parts = {
            "query_key": (query_key, token, by_code),
            "value": (heads, token, None),
            "out": (token, heads, None),
            "widen": (forward, token, None),
            "narrow": (token, forward, None),
        }
        for part, (rows, columns, first_only) in parts.items():
            state[f"{theirs}{part}.weight"] = wide(f"{ours}{part}.weight", rows, columns, first_only)
            state[f"{theirs}{part}.bias"] = wide(f"{ours}{part}.bias", rows)
        for norm in _NORMS:
            state |= {f"{theirs}{norm}.{kind}": wide(f"{ours}{norm}.{kind}", token) for kind in ("weight", "bias")}
    for block in range(spec.transformer.blocks):
        before = f"transformer.layers.{4 * block + 1}.norm_feed_forward."
        for layer in (4 * block + 2, 4 * block + 3):
            gain, offset = state[f"{before}weight"], state[f"{before}bias"]
            state |= _identity_layer(state, f"transformer.layers.{layer}.", gain, offset)
    columns = token
    for index in range(len(spec.dilations) + 1):
        rows = _duplicates(width if index < len(spec.dilations) else spec.out_channels)
        name = f"dense.{3 * index}.weight"
        state |= {name: wide(name, rows, columns)} | _norm(small, f"dense.{3 * index + 1}", rows)
        columns = rows
    for head in ("classes", "boxes", "directions"):
        state[f"heads.{head}.weight"] = wide(f"heads.{head}.weight", None, columns)
        state[f"heads.{head}.bias"] = small[f"heads.{head}.bias"]
    state["heads.anchor_size_m"] = small["heads.anchor_size_m"]
    return {name: tensor.clone() for name, tensor in state.items()}


def _duplicates(channels: int) -> Tensor:
    """Return the small channel that each of twice as many channels duplicates: 0, 0, 1, 1, ..."""
    return torch.arange(2 * channels) // 2


def _token_duplicates(width: int) -> Tensor:
    """Return the small channel of each token channel; first duplicates have the small network's position codes.

    Position codes are sine and cosine in turn, at twice as many rates: every second rate is one of the small network.
    """
    channel = torch.arange(2 * width)
    return channel // 4 * 2 + channel % 2


def _head_duplicates(width: int, heads: int) -> Tensor:
    """Return the small channel of each attention channel: duplicates are whole heads, so that products stay equal."""
    size = width // heads
    channel = torch.arange(2 * width)
    return channel // (2 * size) * size + channel % size


def _shared(weight: Tensor, source: Tensor, draw: torch.Generator, first_only: Tensor | None) -> Tensor:
    """Divide weights (out, in, ...) between the duplicates of each input, so that the sum stays the same.

    first_only: (2 in,) bool, the duplicates that get the whole weight, for weights (out, in).
    """
    if first_only is not None:
        share = first_only.to(weight.dtype).expand(len(weight), -1)
    else:
        pairs = torch.argsort(source, stable=True).view(-1, 2)
        drawn = _LEAST_SHARE + (1.0 - 2.0 * _LEAST_SHARE) * torch.rand(weight.shape, generator=draw)
        share = torch.empty(len(weight), len(source), *weight.shape[2:])
        share[:, pairs[:, 0]], share[:, pairs[:, 1]] = drawn, 1.0 - drawn
    return weight[:, source] * share


def _norm(small: Mapping[str, Tensor], name: str, rows: Tensor) -> dict[str, Tensor]:
    """Return a batch norm's tensors with every channel duplicated."""
    kinds = ("weight", "bias", "running_mean", "running_var")
    count = f"{name}.num_batches_tracked"
    return {f"{name}.{kind}": small[f"{name}.{kind}"][rows] for kind in kinds} | {count: small[count]}


def _identity_layer(state: Mapping[str, Tensor], layer: str, gain: Tensor, offset: Tensor) -> dict[str, Tensor]:
    """Return tensors that make a layer nearly the identity on outputs of a norm with this gain and offset."""
    parts = {f"{layer}{part}.{kind}" for part in ("out", "narrow") for kind in ("weight", "bias")}
    found = {name: torch.zeros_like(state[name]) for name in parts}
    size = (gain.square().mean() + offset.var(unbiased=False)).sqrt()
    for norm in _NORMS:
        found[f"{layer}{norm}.weight"] = size.expand_as(gain)
        found[f"{layer}{norm}.bias"] = offset.mean().expand_as(offset)
    return found
