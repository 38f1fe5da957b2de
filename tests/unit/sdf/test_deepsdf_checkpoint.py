"""Decoders in the original layout give the original network's values; foreign or missing keys are named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor, nn

from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.deepsdf_checkpoint import load_deepsdf_checkpoint

CODE = 4
PUBLISHED = {"dims": [16, 16, 16], "latent_in": [2], "weight_norm": True, "norm_layers": [0, 1, 2]}
VARIANTS: dict[str, dict[str, Any]] = {
    "published": PUBLISHED,
    "no tanh requested": {**PUBLISHED, "use_tanh": False},
    "tanh requested": {**PUBLISHED, "use_tanh": True},
    "weight norm on some layers": {**PUBLISHED, "norm_layers": [1]},
    "layer norm": {**PUBLISHED, "weight_norm": False},
    "layer norm on some layers": {**PUBLISHED, "weight_norm": False, "norm_layers": [0, 3]},
    "no norm": {"dims": [16, 16, 16], "latent_in": [2]},
    "two skips": {**PUBLISHED, "dims": [16, 16, 16, 16], "latent_in": [2, 3]},
    "no skip": {**PUBLISHED, "latent_in": []},
    "point in all": {**PUBLISHED, "xyz_in_all": True, "latent_in": []},
    "point in all and a skip": {**PUBLISHED, "xyz_in_all": True},
    "uneven": {**PUBLISHED, "dims": [24, 16, 20]},
    "dropout": {**PUBLISHED, "dropout": [0, 1], "dropout_prob": 0.5, "latent_dropout": True},
}


class Original(nn.Module):
    """The published network as its code runs it, written plainly: layer by layer on (z, x)."""

    def __init__(self, network: dict[str, Any]) -> None:
        super().__init__()
        self.network = network
        widths = [CODE + 3, *network["dims"], 1]
        last = len(widths) - 2
        for i in range(len(widths) - 1):
            out = widths[i + 1]
            if i + 1 in network["latent_in"]:
                out -= CODE + 3
            elif network.get("xyz_in_all") and i < last:
                out -= 3
            linear = nn.Linear(widths[i], out)
            listed = i in network.get("norm_layers", [])
            if listed and network.get("weight_norm"):
                linear = torch.nn.utils.weight_norm(linear)
                linear.weight_g.data *= torch.rand_like(linear.weight_g) + 0.5
            elif listed:
                norm = nn.LayerNorm(out)
                norm.weight.data.uniform_(0.5, 2.0)
                norm.bias.data.normal_()
                self.add_module(f"bn{i}", norm)
            self.add_module(f"lin{i}", linear)

    def forward(self, entry: Tensor) -> Tensor:
        hidden, last = entry, len(self.network["dims"])
        for i in range(last + 1):
            if i in self.network["latent_in"]:
                hidden = torch.cat([hidden, entry], 1)
            elif i > 0 and self.network.get("xyz_in_all"):
                hidden = torch.cat([hidden, entry[:, -3:]], 1)
            hidden = self.get_submodule(f"lin{i}")(hidden)
            if i == last and self.network.get("use_tanh"):
                hidden = hidden.tanh()
            if i < last:
                hidden = self.get_submodule(f"bn{i}")(hidden) if hasattr(self, f"bn{i}") else hidden
                hidden = hidden.relu()
        return hidden.tanh()[:, 0]


def load_decoder_and_codes(folder: Path, checkpoint: str = "latest") -> tuple[Any, torch.Tensor]:
    found = load_deepsdf_checkpoint(folder, checkpoint)
    return found.decoder, found.codes


def write_experiment(folder: Path, network: dict[str, Any], prefix: str = "module.") -> tuple[Original, Tensor]:
    """Save like the original code: a DataParallel model's state and an embedding's."""
    torch.manual_seed(0)
    model, codes = Original(network), torch.randn(5, CODE)
    (folder / "ModelParameters").mkdir(parents=True)
    (folder / "LatentCodes").mkdir()
    specs = {"NetworkArch": "deep_sdf_decoder", "CodeLength": CODE, "NetworkSpecs": network}
    (folder / "specs.json").write_text(json.dumps(specs))
    state = {f"{prefix}{name}": value for name, value in model.state_dict().items()}
    torch.save({"epoch": 3, "model_state_dict": state}, folder / "ModelParameters" / "latest.pth")
    torch.save({"epoch": 3, "latent_codes": {"weight": codes}}, folder / "LatentCodes" / "latest.pth")
    return model.eval(), codes


@pytest.mark.parametrize("variant", VARIANTS)
def test_values_are_the_original_networks(tmp_path: Path, variant: str) -> None:
    model, codes = write_experiment(tmp_path, VARIANTS[variant])
    decoder, found = load_decoder_and_codes(tmp_path)
    assert torch.equal(found, codes)
    x = torch.rand(50, 3) * 2 - 1
    entry = torch.cat([codes[2].expand(50, -1), x], 1)
    with torch.no_grad():
        expected = model(entry)
        assert expected.std() > 0.01
        assert decoder(entry[:, :CODE], x).sub(expected).abs().max() <= 1e-7
        assert decoder.field(codes[2])(x).sub(expected).abs().max() <= 1e-6
        counterpart = decoder.double().field(codes[2].double())(x.double())
        assert counterpart.sub(model.double()(entry.double())).abs().max() < 1e-7  # the folding alone is float32


@pytest.mark.parametrize("variant", ["published", "layer norm", "point in all and a skip"])
def test_gradients_and_longer_codes(tmp_path: Path, variant: str) -> None:
    write_experiment(tmp_path, VARIANTS[variant])
    decoder, codes = load_decoder_and_codes(tmp_path)
    decoder = decoder.double()
    z, x = codes[1].double().requires_grad_(), torch.rand(4, 3, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda z, x: decoder.field(z)(x), (z, x))
    before = decoder.field(z)(x).detach()
    after = decoder.with_code_scale(3.0).field(3.0 * z)(x).detach()
    assert torch.allclose(before, after, atol=1e-12)
    with pytest.raises(InputError, match="latent code"):
        decoder.field(torch.zeros(CODE + 1))


def test_the_published_kind_is_rendered_as_our_own(tmp_path: Path) -> None:
    write_experiment(tmp_path / "a", PUBLISHED)
    write_experiment(tmp_path / "b", VARIANTS["layer norm"])
    assert isinstance(load_decoder_and_codes(tmp_path / "a")[0], Decoder)
    assert not isinstance(load_decoder_and_codes(tmp_path / "b")[0], Decoder)


def test_keys_without_prefix_and_of_newer_torch(tmp_path: Path) -> None:
    model, codes = write_experiment(tmp_path, PUBLISHED, prefix="")
    path = tmp_path / "ModelParameters" / "latest.pth"
    plain = load_decoder_and_codes(tmp_path)[0].field(codes[0])(torch.eye(3))
    state = {
        name.replace("weight_g", "parametrizations.weight.original0").replace(
            "weight_v", "parametrizations.weight.original1"
        ): value
        for name, value in model.state_dict().items()
    }
    torch.save({"epoch": 3, "model_state_dict": state}, path)
    assert torch.equal(load_decoder_and_codes(tmp_path)[0].field(codes[0])(torch.eye(3)), plain)


def test_three_forms_of_codes_and_a_checkpoint_by_its_epoch(tmp_path: Path) -> None:
    _, codes = write_experiment(tmp_path, PUBLISHED)
    weights = (tmp_path / "ModelParameters" / "latest.pth").read_bytes()
    (tmp_path / "ModelParameters" / "2000.pth").write_bytes(weights)
    for form in (codes[:, None, :], [code[None] for code in codes]):
        torch.save({"epoch": 3, "latent_codes": form}, tmp_path / "LatentCodes" / "2000.pth")
        assert torch.equal(load_decoder_and_codes(tmp_path, "2000")[1], codes)
    with pytest.raises(InputError, match=r"100\.pth: no such file. Choose a checkpoint from 2000, latest"):
        load_decoder_and_codes(tmp_path, "100")


def test_subnormal_weights_are_zeroed(tmp_path: Path) -> None:
    write_experiment(tmp_path, PUBLISHED)
    path = tmp_path / "ModelParameters" / "latest.pth"
    content = torch.load(path, weights_only=True)
    content["model_state_dict"]["module.lin1.weight_g"][3] = 1e-39
    torch.save(content, path)
    decoder, _ = load_decoder_and_codes(tmp_path)
    weight = decoder.layers[1].weight
    assert isinstance(weight, Tensor) and (weight[3] == 0).all() and (weight[2] != 0).any()


def edit(folder: Path, part: str, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / part / "latest.pth"
    content = torch.load(path, weights_only=True)
    change(content)
    torch.save(content, path)


def repeated(*shape: int) -> Tensor:
    return torch.zeros(1, dtype=torch.float16).expand(shape)


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("ModelParameters", lambda c: c["model_state_dict"].pop("module.lin1.bias"), "tensor lin1.bias is missing"),
        ("ModelParameters", lambda c: c["model_state_dict"].pop("module.lin1.weight_g"), "lin1.weight_g is missing"),
        ("ModelParameters", lambda c: c["model_state_dict"].update(extra=torch.ones(1)), "tensor extra belongs to"),
        ("ModelParameters", lambda c: c["model_state_dict"]["module.lin3.bias"].fill_(torch.nan), "not finite"),
        ("ModelParameters", lambda c: c["model_state_dict"].update({"module.lin3.bias": torch.ones(2)}), "has shape"),
        ("ModelParameters", lambda c: c.pop("model_state_dict"), "no model_state_dict"),
        ("LatentCodes", lambda c: c.pop("latent_codes"), "no table of latent_codes"),
        ("LatentCodes", lambda c: c.update(latent_codes={"weight": torch.ones(5, 3)}), "5 codes of length 3"),
        ("LatentCodes", lambda c: c["latent_codes"]["weight"].fill_(torch.inf), "not finite"),
        # Terabytes, in a file of a kilobyte:
        ("LatentCodes", lambda c: c.update(latent_codes=repeated(2**37, 1, CODE)), "no table of latent_codes"),
        (
            "ModelParameters",
            lambda c: c["model_state_dict"].update({"module.lin0.weight_v": repeated(2**20, 2**20)}),
            "lin0.weight_v is float16.*not dense",
        ),
        ("LatentCodes", lambda c: c.update(epoch=9), "is of epoch 9, the weights are of epoch 3"),
    ],
    ids=lambda value: value.replace(" ", "_") if isinstance(value, str) else "",
)
def test_missing_and_foreign_content_is_named(
    tmp_path: Path, part: str, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    write_experiment(tmp_path, PUBLISHED)
    edit(tmp_path, part, change)
    with pytest.raises(InputError, match=message) as failure:
        load_decoder_and_codes(tmp_path)
    assert part in str(failure.value) and failure.value.remedy


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"NetworkArch": "siren"}, "NetworkArch is 'siren'"),
        ({"NetworkSpecs": {}}, "KeyError: 'dims'"),
        ({"NetworkSpecs": {"dims": [5, 5], "latent_in": [1]}}, "layer of size -2"),
        ({"CodeLength": "long"}, "no readable description"),
        ({"Instances": ["a", "b"]}, "2 names for 5 codes"),
    ],
    ids=str,
)
def test_specs_that_cannot_be_used_are_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    write_experiment(tmp_path, PUBLISHED)
    path = tmp_path / "specs.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InputError, match=message) as failure:
        load_decoder_and_codes(tmp_path)
    assert "specs.json" in str(failure.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"specs\.json: no such file"):
        load_decoder_and_codes(tmp_path)
    write_experiment(tmp_path, PUBLISHED)
    (tmp_path / "ModelParameters" / "latest.pth").write_bytes(b"PK broken")
    with pytest.raises(InputError, match="not a readable checkpoint of tensors only"):
        load_decoder_and_codes(tmp_path)
    (tmp_path / "specs.json").write_text("{")
    with pytest.raises(InputError, match="no readable description of a network"):
        load_decoder_and_codes(tmp_path)


def test_real_decoder_is_zero_on_its_cars(real_data: Callable[[str], Path]) -> None:
    """Every eighth car has its own code; 500 surface points, in units of 2.4 m; files deviate by 2 cm at 4.5 m."""
    experiment = load_deepsdf_checkpoint(real_data("decoder"))
    assert len(experiment.instances) == len(experiment.codes) == 57
    for index in range(0, 57, 8):
        mesh = trimesh.load(real_data("vehicles") / f"{experiment.instances[index]}.ply")
        points, _ = trimesh.sample.sample_surface(mesh, 500, seed=index)
        field = experiment.decoder.field(experiment.codes[index])
        distance = field(torch.from_numpy(np.asarray(points, np.float32))).abs()
        assert float(distance.median()) < 0.002 and float(distance.mean()) < 0.004
        other = experiment.decoder.field(experiment.codes[(index + 20) % 57])
        assert float(other(torch.from_numpy(np.asarray(points, np.float32))).abs().mean()) > 2 * float(distance.mean())
        outside = torch.tensor([[0.0, 0.95, 0.0], [0.9, 0.0, 0.0], [0.0, -0.9, 0.0]])
        assert float(field(torch.zeros(1, 3))) < -0.05 < 0.05 < float(field(outside).min())
