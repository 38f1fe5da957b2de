"""Decoders in the layout of the original DeepSDF repository (specs.json, ModelParameters, LatentCodes)."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder, decoder_from_tensors


def _read(path: Path) -> Any:
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="a folder in the original DeepSDF layout")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        raise InputError(
            "not a readable checkpoint of tensors only", where=str(path), remedy="copy it again"
        ) from error


def load_foreign_decoder(folder: Path | str, checkpoint: str = "latest") -> tuple[Decoder, Tensor]:
    """The decoder and the codes (N, code) float32 of a checkpoint in the original layout.

    The original always ends in tanh, whatever `use_tanh` says. Weight-norm pairs (weight_g, weight_v) are folded; a
    `module.` prefix is dropped. Never unpickles anything but tensors.
    Raises: InputError naming the file when something is missing, or the network is not the published kind.
    """
    folder = Path(folder)
    specs_file = folder / "specs.json"
    if not specs_file.is_file():
        raise InputError("no such file", where=str(specs_file), remedy="a folder in the original DeepSDF layout")
    specs = json.loads(specs_file.read_text())
    network = specs["NetworkSpecs"]
    unsupported = [key for key in ("xyz_in_all", "latent_dropout") if network.get(key)]
    layer_norms = bool(network.get("norm_layers")) and not network.get("weight_norm", False)
    if unsupported or layer_norms or len(network.get("latent_in", [])) != 1:
        raise InputError(
            "not the published network", where=f"{specs_file}: NetworkSpecs", remedy="weight norm, one skip"
        )
    architecture = Architecture(
        code_length=int(specs["CodeLength"]),
        width=int(network["dims"][0]),
        hidden_layers=len(network["dims"]),
        skip_layer=int(network["latent_in"][0]),
    )
    state = _read(folder / "ModelParameters" / f"{checkpoint}.pth")["model_state_dict"]
    state = {name.removeprefix("module."): value for name, value in state.items()}
    tensors = {}
    for index in range(architecture.hidden_layers + 1):
        tensors[f"layers.{index}.bias"] = state[f"lin{index}.bias"]
        tensors[f"layers.{index}.weight"] = _folded(state, f"lin{index}")
    codes = _read(folder / "LatentCodes" / f"{checkpoint}.pth")["latent_codes"]
    table = codes["weight"] if isinstance(codes, dict) else torch.stack([code.reshape(-1) for code in codes])
    return decoder_from_tensors(tensors, architecture, str(folder)), table.float()


def _folded(state: dict[str, Tensor], name: str) -> Tensor:
    if f"{name}.weight" in state:
        return state[f"{name}.weight"].clone()
    direction: Tensor = state[f"{name}.weight_v"]
    scale = state[f"{name}.weight_g"] / direction.norm(dim=1, keepdim=True)
    return torch.mul(direction, scale)
