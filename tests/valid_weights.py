"""Small handmade weight files: a decoder, a vehicle set, an experiment in the original DeepSDF layout."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file

from shift3d.sdf.decoder import Architecture, Decoder, save_decoder

SMALL = Architecture(code_length=4, width=16, hidden_layers=3, skip_layer=2)
DECODER, VEHICLES = "sdf.safetensors", "vehicles.safetensors"


@functools.cache
def _small_decoder() -> Decoder:
    torch.manual_seed(0)
    return Decoder(SMALL).folded()


def write_decoder(folder: Path) -> None:
    save_decoder(_small_decoder(), folder / DECODER, {"recipe": json.dumps({"steps": 3})})


@functools.cache
def _vehicle_set() -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    rng = np.random.default_rng(4)
    codes = rng.normal(0.0, 0.05, (3, 256)).astype(np.float32)
    facts = {
        "body_type": "suv",
        "scale_m": 2.5,
        "sdf_R_object": [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        "sdf_t_object": [0.01, -0.02, 0.0],
        "size_m": [4.5, 1.9, 1.6],
        "pieces": 1,
    }
    baselines = {name: {**facts, "body_type": name} for name in ("suv", "coupe")}
    arrays = {f"{name}.latent_code": codes[i] for i, name in enumerate(baselines)}
    arrays |= {"family.codes": codes, "family.scale_m": np.full(3, 2.4, np.float32)}
    arrays["family.size_m"] = np.tile(np.array([4.4, 1.8, 1.5], np.float32), (3, 1))
    family = {"body_types": ["suv", "coupe", "van"], "seed": 7, "count": 3}
    return arrays, {"baselines": json.dumps(baselines), "family": json.dumps(family)}


def write_vehicles(folder: Path) -> None:
    arrays, metadata = _vehicle_set()
    save_file(arrays, folder / VEHICLES, metadata=metadata)


NETWORKS: dict[str, dict[str, Any]] = {
    "published": {"dims": [16, 16, 16], "latent_in": [2], "weight_norm": True, "norm_layers": [0, 1, 2]},
    "layer norm": {"dims": [16, 16, 16], "latent_in": [2], "weight_norm": False, "norm_layers": [0, 1]},
}
_CODE = 4


def _experiment_tensors(network: dict[str, Any]) -> dict[str, torch.Tensor]:
    """Return a model's state as the original code saves it: weight norm as pairs, under DataParallel's prefix."""
    generator = torch.Generator().manual_seed(5)
    widths = [_CODE + 3, *network["dims"], 1]
    state = {}
    for layer in range(len(widths) - 1):
        outputs = widths[layer + 1] - (_CODE + 3 if layer + 1 in network["latent_in"] else 0)
        weight = torch.randn(outputs, widths[layer], generator=generator) / widths[layer] ** 0.5
        normed = layer in network["norm_layers"]
        if normed and network["weight_norm"]:
            state[f"module.lin{layer}.weight_g"] = weight.norm(dim=1, keepdim=True)
            state[f"module.lin{layer}.weight_v"] = weight
        else:
            state[f"module.lin{layer}.weight"] = weight
        state[f"module.lin{layer}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
        if normed and not network["weight_norm"]:
            state[f"module.bn{layer}.weight"], state[f"module.bn{layer}.bias"] = (
                torch.ones(outputs),
                torch.zeros(outputs),
            )
    return state


def write_experiment(folder: Path, variant: str) -> None:
    network = NETWORKS[variant]
    for part in ("ModelParameters", "LatentCodes"):
        (folder / part).mkdir()
    names = [f"car_{index}" for index in range(3)]
    specs = {"NetworkArch": "deep_sdf_decoder", "CodeLength": _CODE, "NetworkSpecs": network, "Instances": names}
    (folder / "specs.json").write_text(json.dumps(specs, indent=1))
    content = {"epoch": 3, "model_state_dict": _experiment_tensors(network)}
    torch.save(content, folder / "ModelParameters" / "latest.pth")
    codes = torch.randn(3, _CODE, generator=torch.Generator().manual_seed(6))
    torch.save({"epoch": 3, "latent_codes": {"weight": codes}}, folder / "LatentCodes" / "latest.pth")
