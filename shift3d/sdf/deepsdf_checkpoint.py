"""Loader of decoders in the layout of the original DeepSDF repository (specs.json, ModelParameters, LatentCodes)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, decoder_from_tensors
from shift3d.sdf.deepsdf_network import DeepSdfNetwork, NetworkSpecs
from shift3d.sdf.tensors import LARGEST_INPUT, checked_tensors, described, is_plain

_NETWORK = "deep_sdf_decoder"
_LAYOUT = "Give a folder in the original DeepSDF layout"
_KNOWN_SPECS = {
    *("dims", "norm_layers", "latent_in", "weight_norm", "xyz_in_all", "use_tanh"),
    *("dropout", "dropout_prob", "latent_dropout"),  # used in training only
}


@dataclass(frozen=True)
class DeepSdfCheckpoint:
    """Trained auto-decoder of the original repository.

    decoder: folded float32 weights, eval mode, requires_grad False; a `Decoder`, which renders faster, if the network
    has the published form. codes: (N, code) float32 as trained. instances: N names, in code order.
    """

    decoder: DeepSdfNetwork
    codes: Tensor
    instances: tuple[str, ...]


def experiment_file_names(checkpoint: str = "latest") -> tuple[str, str, str]:
    """Return the names of specs.json, the network's weights and the codes, below an experiment's folder."""
    return "specs.json", f"ModelParameters/{checkpoint}.pth", f"LatentCodes/{checkpoint}.pth"


def experiment_files(folder: Path | str, checkpoint: str = "latest") -> tuple[Path, Path, Path]:
    """Return the paths of specs.json, the network's weights and the codes of a checkpoint ("latest", or "2000").

    Raises: InputError naming the missing file and the existing checkpoints.
    """
    specs, weights, codes = (Path(folder) / name for name in experiment_file_names(checkpoint))
    if not specs.is_file():
        raise InputError("no such file", where=str(specs), remedy=_LAYOUT)
    for path in (weights, codes):
        if not path.is_file():
            there = sorted(found.stem for found in path.parent.glob("*.pth"))
            remedy = f"Choose a checkpoint from {', '.join(there)}" if there else _LAYOUT
            raise InputError("no such file", where=str(path), remedy=remedy)
    return specs, weights, codes


def load_deepsdf_checkpoint(folder: Path | str, checkpoint: str = "latest") -> DeepSdfCheckpoint:
    """Load a checkpoint in the original layout; its values equal those of the original code up to rounding.

    checkpoint: "latest" or an epoch. Weight-norm pairs, of old and new torch, are folded; a `module.` prefix is
    dropped. Only tensors and plain values are unpickled.
    Raises: InputError naming file and key for an entry that is missing, foreign, of another shape or not finite, for
        weights and codes of different epochs, or for another network than the original one.
    """
    specs_file, weights_file, codes_file = experiment_files(folder, checkpoint)
    values, specs = _read_specs(specs_file)
    weights, codes = _read(weights_file), _read(codes_file)
    epochs = _epoch(weights, weights_file), _epoch(codes, codes_file)
    if None not in epochs and epochs[0] != epochs[1]:
        what = f"is of epoch {epochs[1]}, the weights are of epoch {epochs[0]}"
        raise InputError(what, where=str(codes_file), remedy="Give codes and weights of one checkpoint")
    table = _codes(codes, specs.code_length, codes_file)
    names = _instances(values, len(table), specs_file)
    return DeepSdfCheckpoint(_network(weights, specs, weights_file), table, names)


def _epoch(content: dict[str, Any], path: Path) -> int | None:
    epoch = content.get("epoch")
    if not isinstance(epoch, int | None):
        raise InputError(f"epoch is a {type(epoch).__name__}", where=str(path), remedy="Save it as a whole number")
    return epoch


def _read(path: Path) -> dict[str, Any]:
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged pickle can raise any error
        raise InputError("not a readable checkpoint of tensors only", str(path), "Copy it again") from error
    if not isinstance(content, dict):
        raise InputError(f"holds a {type(content).__name__}, no table by name", where=str(path), remedy=_LAYOUT)
    return content


def _read_specs(path: Path) -> tuple[dict[str, Any], NetworkSpecs]:
    try:
        values = json.loads(path.read_text())
        network = values["NetworkSpecs"]
        if unknown := sorted(set(network) - _KNOWN_SPECS):
            # The original passes all entries to the network's constructor, which refuses unknown ones. Ignoring one
            # would load the same weights into another network.
            raise ValueError(f"{unknown[0]} is nothing that the original network has")
        specs = NetworkSpecs(
            code_length=_whole(values["CodeLength"]),
            dims=tuple(_whole(width) for width in network["dims"]),
            norm_layers=tuple(_whole(layer) for layer in network.get("norm_layers") or ()),
            latent_in=tuple(_whole(layer) for layer in network.get("latent_in") or ()),
            weight_norm=_switch(network, "weight_norm"),
            xyz_in_all=_switch(network, "xyz_in_all"),
            use_tanh=_switch(network, "use_tanh"),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        what = f"no readable description of a network ({type(error).__name__}: {str(error)[:200]})"
        raise InputError(what, where=str(path), remedy="Give CodeLength, and NetworkSpecs with dims") from error
    name = values.get("NetworkArch", _NETWORK)
    if name != _NETWORK:
        raise InputError(f"NetworkArch is {str(name)[:80]!r}", str(path), f"Give a checkpoint of {_NETWORK}")
    sizes = [size for layer in range(specs.layers) for size in specs.size(layer)]
    if not specs.dims or specs.code_length < 1 or min(sizes) < 1:
        what = f"NetworkSpecs gives a layer of size {min(sizes)}"
        raise InputError(what, where=str(path), remedy="Give dims that leave room for latent_in and xyz_in_all")
    return values, specs


def _whole(value: Any) -> int:
    """Check for a whole number: 512, not 512.5, "512" or true. Raises: ValueError."""
    if type(value) is not int or abs(value) > 2**31:
        raise ValueError(f"{value!r} is no whole number")
    return value


def _switch(network: dict[str, Any], name: str) -> bool:
    """Return true or false; a missing entry or null is false. Raises: ValueError, e.g. for the string "false"."""
    value = network.get(name)
    if not isinstance(value, bool | None):
        raise ValueError(f"{name} is {value!r}, neither true nor false")
    return bool(value)


def _codes(content: dict[str, Any], length: int, path: Path) -> Tensor:
    """Return (N, code) from any of three forms: an embedding's state, a tensor N x 1 x code, a list of tensors."""
    found = content.get("latent_codes")
    if isinstance(found, dict):
        found = found.get("weight")
    if isinstance(found, list | tuple) and found and all(is_plain(code) for code in found):
        alike = len({code.numel() for code in found}) == 1
        found = torch.stack([code.detach().reshape(-1) for code in found]) if alike else None
    if not is_plain(found) or found.ndim < 2 or not len(found):
        raise InputError("no table of latent_codes", str(path), "Save latent_codes as N x code, or as a list")
    table: Tensor = found.detach().reshape(len(found), -1).float()
    if table.shape[1] != length:
        what = f"latent_codes are {len(table)} codes of length {table.shape[1]}"
        raise InputError(what, where=str(path), remedy=f"Give codes of CodeLength {length}, as in specs.json")
    if not float(table.abs().max()) <= LARGEST_INPUT:  # so that NaN does not pass
        what = f"latent_codes hold values that are not finite, or beyond {LARGEST_INPUT:g}"
        raise InputError(what, where=str(path), remedy="Copy it again")
    return table


def _instances(values: dict[str, Any], count: int, path: Path) -> tuple[str, ...]:
    """Return the names in specs.json. The original keeps names in its split files; without names: shape_00042 etc."""
    listed = values.get("Instances")
    if listed is None:
        return tuple(f"shape_{index:05d}" for index in range(count))
    names = tuple(str(name) for name in listed) if isinstance(listed, list) else ()
    if len(names) != count or len(set(names)) != count:
        what = f"Instances are {len(set(names))} names for {count} codes"
        raise InputError(what, where=str(path), remedy="Give one name a code, in code order, each once")
    return names


def _published(specs: NetworkSpecs) -> Architecture | None:
    """Return the same network as `Architecture`, None unless one width, one skip, no norm, xyz_in_all, use_tanh."""
    norms = any(specs.normed(layer) for layer in range(specs.layers - 1))
    alike = len(set(specs.dims)) == 1 and len(specs.latent_in) == 1 and not (norms or specs.xyz_in_all)
    if not alike or specs.use_tanh or not 0 < specs.latent_in[0] < specs.layers - 1:
        return None
    return Architecture(specs.code_length, specs.dims[0], len(specs.dims), specs.latent_in[0])


def _network(content: dict[str, Any], specs: NetworkSpecs, path: Path) -> DeepSdfNetwork:
    state = content.get("model_state_dict")
    if not isinstance(state, dict):
        raise InputError("no model_state_dict", where=str(path), remedy=_LAYOUT)
    left: dict[str, Any] = {str(name).removeprefix("module."): value for name, value in state.items()}
    if len(left) != len(state):
        what = "a tensor is there with the prefix module. and without it"
        raise InputError(what, where=str(path), remedy="Leave out the one that is not meant")
    tensors = {}
    for layer in range(specs.layers):
        tensors[f"layers.{layer}.weight"] = _folded(left, f"lin{layer}", path)
        tensors[f"layers.{layer}.bias"] = _take(left, f"lin{layer}.bias", path)
        if specs.normed(layer):
            for part in ("weight", "bias"):
                tensors[f"norms.{layer}.{part}"] = _take(left, f"bn{layer}.{part}", path)
    if left:
        what = f"tensor {min(left)} belongs to another network than specs.json describes"
        raise InputError(what, where=str(path), remedy="Give the specs.json that it was trained with")
    if architecture := _published(specs):
        return decoder_from_tensors(tensors, architecture, str(path))
    called = {name: name.replace("layers.", "lin").replace("norms.", "bn") for name in tensors}
    tensors = checked_tensors(tensors, specs, str(path), called)
    network = DeepSdfNetwork(specs).eval().requires_grad_(False)
    network.load_state_dict(tensors)
    return network


def _take(left: dict[str, Any], name: str, path: Path) -> Tensor:
    value = left.pop(name, None)
    if not isinstance(value, Tensor):
        raise InputError(f"tensor {name} is missing", where=str(path), remedy="Save it, too: specs.json asks for it")
    if not is_plain(value):
        raise InputError(f"tensor {name} {described(value)}", where=str(path), remedy="Save it as dense float32")
    return value.float()


def _folded(left: dict[str, Any], name: str, path: Path) -> Tensor:
    """Return a layer's weight, folded from the weight-norm pair (length, direction) if there is one."""
    for length, direction in (
        ("weight_g", "weight_v"),
        ("parametrizations.weight.original0", "parametrizations.weight.original1"),
    ):
        if f"{name}.{length}" in left or f"{name}.{direction}" in left:
            g, v = _take(left, f"{name}.{length}", path), _take(left, f"{name}.{direction}", path)
            if v.ndim != 2 or g.numel() != len(v):
                what = f"{name}: {tuple(g.shape)} lengths for directions {tuple(v.shape)}"
                raise InputError(what, where=str(path), remedy="Save one length a row")
            lengths = v.norm(dim=1, keepdim=True)
            if not bool(torch.isfinite(lengths).all()):
                # Squares beyond float32: the quotient would be zero and silently disable the layer.
                what = f"{name}.{direction} holds values that are not finite, or too large"
                raise InputError(what, where=str(path), remedy="Copy it again")
            return torch.mul(v, g.reshape(-1, 1) / lengths)
    return _take(left, f"{name}.weight", path)
