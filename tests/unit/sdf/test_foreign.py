"""Decoders in the original repository's layout."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from shift3d.errors import InputError
from shift3d.sdf.foreign import load_foreign_decoder


def write_checkpoint(folder: Path, weight_norm: bool) -> None:
    """Two hidden layers of 16, skip at 1, codes of 4, the way the original writes them (from a DataParallel model)."""
    (folder / "ModelParameters").mkdir(parents=True)
    (folder / "LatentCodes").mkdir()
    network = {
        "dims": [16, 16],
        "latent_in": [1],
        "xyz_in_all": False,
        "weight_norm": weight_norm,
        "norm_layers": [0, 1],
    }
    (folder / "specs.json").write_text(json.dumps({"CodeLength": 4, "NetworkSpecs": network}))
    torch.manual_seed(0)
    state = {}
    for index, (inputs, outputs) in enumerate([(7, 9), (16, 16), (16, 1)]):
        state[f"module.lin{index}.bias"] = torch.randn(outputs)
        if weight_norm and index < 2:
            state[f"module.lin{index}.weight_g"] = torch.rand(outputs, 1) + 0.5
            state[f"module.lin{index}.weight_v"] = torch.randn(outputs, inputs)
        else:
            state[f"module.lin{index}.weight"] = torch.randn(outputs, inputs)
    torch.save({"epoch": 3, "model_state_dict": state}, folder / "ModelParameters" / "latest.pth")
    codes = {"weight": torch.randn(5, 4)}
    torch.save({"epoch": 3, "latent_codes": codes}, folder / "LatentCodes" / "latest.pth")


def test_values_are_those_of_the_stored_numbers(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, weight_norm=True)
    decoder, codes = load_foreign_decoder(tmp_path)
    state = torch.load(tmp_path / "ModelParameters" / "latest.pth", weights_only=True)["model_state_dict"]
    entry = torch.cat([codes[2], torch.tensor([0.1, -0.2, 0.3])])
    hidden = entry
    for index in range(3):
        if index == 1:
            hidden = torch.cat([hidden, entry])
        name = f"module.lin{index}"
        if f"{name}.weight" in state:
            weight = state[f"{name}.weight"]
        else:
            direction = state[f"{name}.weight_v"]
            weight = state[f"{name}.weight_g"] * direction / direction.norm(dim=1, keepdim=True)
        hidden = weight @ hidden + state[f"{name}.bias"]
        if index < 2:
            hidden = hidden.relu()
    assert decoder.field(codes[2])(entry[None, 4:]) == pytest.approx(hidden.tanh(), abs=1e-6)


def test_another_kind_of_network_is_refused(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, weight_norm=False)
    with pytest.raises(InputError, match=r"specs\.json"):
        load_foreign_decoder(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        load_foreign_decoder(tmp_path / "nowhere")


def test_real_decoder_knows_its_cars(real_data: Callable[[str], Path]) -> None:
    decoder, codes = load_foreign_decoder(real_data("decoder"))
    assert codes.shape == (57, 256)
    field = decoder.field(codes[0])
    assert float(field(torch.zeros(1, 3))) < -0.05
    assert float(field(torch.tensor([[0.0, 0.95, 0.0]]))) > 0.05
