"""Mutants of weights: decoders and detectors in safetensors, vehicle sets, and original DeepSDF experiments."""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from feeding import InputKind, register
from mutations import Rng, mutate_bytes, pick
from random_networks import SLIM, random_net
from safetensors.numpy import load_file, save_file
from valid_weights import DECODER, NETWORKS, VEHICLES, write_decoder, write_experiment, write_vehicles
from value_mutations import mutate_arrays, mutate_values

from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import PointPillarsNet
from shift3d.detectors.models.sst import SstNet
from shift3d.detectors.models.weights import load_weights
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.sdf.decoder import load_decoder
from shift3d.sdf.deepsdf_checkpoint import load_deepsdf_checkpoint
from shift3d.vehicles.sources import VehicleSet, vehicle_hash
from shift3d.vehicles.vehicle import Vehicle, family_seed, family_vehicles

torch.set_num_threads(1)
POINTS = torch.from_numpy(np.random.default_rng(1).uniform(-1.0, 1.0, (30, 3)).astype(np.float32))


def field_values(decoder: Any, code: torch.Tensor) -> list[float]:
    """Return g at some points after checks: finite, within tanh's range, finite gradients by code and points."""
    z, x = code.clone().requires_grad_(), POINTS.clone().requires_grad_()
    values = decoder.field(z)(x)
    assert values.shape == (len(x),) and values.dtype == torch.float32
    gradients = torch.autograd.grad(values.sum(), (z, x), allow_unused=True)
    assert all(g is None or bool(torch.isfinite(g).all()) for g in gradients)
    assert bool((values.abs() <= 1.0).all())
    return [round(float(value), 5) for value in values.detach()]


# --- safetensors


def _shuffled_header(content: bytes, rng: Rng) -> bytes:
    """Return the same file with its tensors described in another order, and one more word of metadata."""
    length = struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8 : 8 + length])
    names = list(header)
    described = {name: header[name] for name in rng.permutation(names)}
    described["__metadata__"] = {**header.get("__metadata__", {}), "note": "copied"}
    return _with_header(described, content[8 + length :])


def _with_header(header: Any, data: bytes) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + data


def _mutated_header(content: bytes, rng: Rng) -> bytes:
    length = struct.unpack("<Q", content[:8])[0]
    return _with_header(mutate_values(json.loads(content[8 : 8 + length]), rng), content[8 + length :])


def _mutated_metadata(path: Path, rng: Rng) -> None:
    """Change a JSON text inside the metadata."""
    from safetensors import safe_open

    with safe_open(str(path), framework="np") as file:
        metadata = dict(file.metadata() or {})
    key = str(pick(sorted(metadata), rng))
    metadata[key] = json.dumps(mutate_values(json.loads(metadata[key]), rng))
    save_file(load_file(path), path, metadata=metadata)


def mutate_safetensors(path: Path, rng: Rng, metadata: bool = True) -> str:
    how = pick(("bytes", "header", "arrays", "arrays", "metadata", "harmless", "pickle"), rng)
    if how == "bytes":
        path.write_bytes(mutate_bytes(path.read_bytes(), rng))
    elif how == "header":
        path.write_bytes(_mutated_header(path.read_bytes(), rng))
    elif how == "metadata" and metadata:
        _mutated_metadata(path, rng)
    elif how == "pickle" and rng.uniform() < 0.3:
        torch.save({name: torch.from_numpy(value) for name, value in load_file(path).items()}, path)
    elif how == "harmless" and rng.uniform() < 0.3:
        path.write_bytes(_shuffled_header(path.read_bytes(), rng))
        return "harmless"
    else:
        return _write_mutated_arrays(path, rng)
    return str(how)


def _write_mutated_arrays(path: Path, rng: Rng) -> str:
    from safetensors import safe_open

    with safe_open(str(path), framework="np") as file:
        metadata = file.metadata()
    arrays = mutate_arrays(load_file(path), rng)
    save_file({name: np.array(value, order="C") for name, value in arrays.items()}, path, metadata=metadata)
    return "arrays"


def load_small_decoder(folder: Path) -> Any:
    decoder = load_decoder(folder / DECODER)
    assert all(bool(torch.isfinite(p).all()) and p.dtype == torch.float32 for p in decoder.parameters())
    return field_values(decoder, torch.full((decoder.architecture.code_length,), 0.3))


# --- detectors, with the slim networks of the other tests

_CLOUD = torch.from_numpy(np.random.default_rng(2).uniform(-1.0, 1.0, (400, 3)).astype(np.float32) * (4.0, 4.0, 1.0))


@functools.cache
def _detector_bytes(name: str) -> bytes:
    from safetensors.torch import save

    return bytes(save({key: value.contiguous() for key, value in random_net(name).state_dict().items()}))


def detector_kind(name: str, count: int) -> InputKind:
    def empty() -> DetectorNet:
        spec = SLIM[name]
        return SstNet(spec) if name == "sst" else PointPillarsNet(spec)  # type: ignore[arg-type]

    def write(folder: Path) -> None:
        (folder / f"{name}.safetensors").write_bytes(_detector_bytes(name))

    def load(folder: Path) -> Any:
        net = load_weights(empty(), folder / f"{name}.safetensors")
        assert not net.training
        detector = TrainedDetector(net)
        cloud = _CLOUD.float().requires_grad_()
        found = detector.proposals(cloud, detector.window_for((0.0, 0.0), 2.0))
        (gradient,) = torch.autograd.grad(found.logits.sum(), cloud)
        assert bool(torch.isfinite(found.logits).all()) and bool(torch.isfinite(found.boxes).all())
        assert bool(torch.isfinite(gradient).all()) and bool((found.boxes[:, 3:6] > 0).all())
        return [round(float(value), 4) for value in found.logits.detach()[::50]]

    def mutate(folder: Path, rng: Rng) -> str:
        return mutate_safetensors(folder / f"{name}.safetensors", rng, metadata=False)

    return InputKind(f"{name} weights", count, write, mutate, load)


# --- vehicle sets


def _check_vehicle(vehicle: Vehicle) -> str:
    assert vehicle.latent_code.shape == (256,) and vehicle.latent_code.dtype == np.float32
    numbers = [vehicle.latent_code, vehicle.sdf_R_object, vehicle.sdf_t_object, np.array(vehicle.size_m)]
    assert all(np.isfinite(array).all() for array in numbers)
    assert 0.05 < vehicle.scale_m < 100.0 and 0.0 < min(vehicle.size_m) <= max(vehicle.size_m) <= 20.0
    there = np.random.default_rng(0).uniform(-2.0, 2.0, (5, 3))
    assert np.allclose(vehicle.to_object(vehicle.to_sdf(there)), there, atol=1e-3)
    # A rotation and one scale: lengths keep their proportions.
    moved = np.linalg.norm(np.diff(vehicle.to_sdf(there), axis=0), axis=1) * vehicle.scale_m
    assert np.allclose(moved, np.linalg.norm(np.diff(there, axis=0), axis=1), rtol=1e-3)
    return vehicle_hash(vehicle)


def load_vehicles(folder: Path) -> Any:
    source = VehicleSet(folder)
    named = [_check_vehicle(source.vehicle(name)) for name in source.names()]
    family = [_check_vehicle(vehicle) for vehicle in family_vehicles(folder / VEHICLES)]
    assert isinstance(family_seed(folder / VEHICLES), int)
    return sorted(named), family


# --- the original layout


def load_any_experiment(folder: Path) -> Any:
    experiment = load_deepsdf_checkpoint(folder)
    codes = experiment.codes
    assert codes.dtype == torch.float32 and codes.ndim == 2 and bool(torch.isfinite(codes).all())
    assert len(experiment.instances) == len(codes) and all(isinstance(name, str) for name in experiment.instances)
    assert all(bool(torch.isfinite(p).all()) for p in experiment.decoder.parameters())
    return experiment.instances, [field_values(experiment.decoder, code) for code in codes[:3]]


def _odd_tensor(value: torch.Tensor, rng: Rng) -> Any:
    how = pick(
        ("nan", "huge", "shape", "int", "half", "double", "complex", "sparse", "list", "none", "tiny", "view"), rng
    )
    if how == "view":
        return value.reshape(-1)[:1].expand(value.shape)
    changed = value.clone()
    if how in ("nan", "huge", "tiny"):
        changed.reshape(-1)[int(rng.integers(value.numel()))] = {"nan": torch.nan, "huge": 3e38, "tiny": 1e-42}[
            str(how)
        ]
        return changed
    return {
        "shape": changed[..., None],
        "int": changed.int(),
        "half": changed.half(),
        "double": changed.double() * 1e300,
        "complex": changed.to(torch.complex64),
        "sparse": changed.to_sparse(),
        "list": changed.tolist(),
        "none": None,
    }[str(how)]


def _mutate_state(state: dict[str, Any], rng: Rng) -> None:
    name = str(pick(sorted(state), rng))
    how = pick(("value", "value", "value", "remove", "rename", "add", "swap"), rng)
    if how == "value":
        state[name] = _odd_tensor(state[name], rng)
    elif how == "remove":
        del state[name]
    elif how == "rename":
        state[pick((name.removeprefix("module."), f"{name}_old", 3), rng)] = state.pop(name)
    elif how == "add":
        state[pick((name.removeprefix("module."), "extra", "module.lin9.bias"), rng)] = torch.zeros(2)
    else:
        other = str(pick(sorted(state), rng))
        state[name], state[other] = state[other], state[name]


def pth_mutator(part: str, key: str) -> Callable[[Path, Rng], str]:
    def mutate(folder: Path, rng: Rng) -> str:
        path = folder / part / "latest.pth"
        how = pick(("bytes", "bytes", "tensors", "tensors", "table"), rng)
        if how == "bytes":
            path.write_bytes(mutate_bytes(path.read_bytes(), rng))
            return "bytes"
        content = torch.load(path, weights_only=True)
        if how == "tensors":
            _mutate_state(content[key], rng)
        else:
            odd = (None, 3, "three", [1], {"a": 1}, torch.ones(3), 2.5, -1, 10**30)
            content[pick(("epoch", key, "more"), rng)] = pick(odd, rng)
        old = bool(rng.uniform() < 0.2)
        torch.save(content, path, _use_new_zipfile_serialization=not old)
        return str(how)

    return mutate


def mutate_specs(folder: Path, rng: Rng) -> str:
    path = folder / "specs.json"
    how = pick(("bytes", "values", "values", "values", "activation", "harmless"), rng)
    values = json.loads(path.read_text())
    if how == "bytes":
        path.write_bytes(mutate_bytes(path.read_bytes(), rng))
        return "bytes"
    if how == "harmless":
        values["Description"], values["NetworkSpecs"]["dropout"] = "a note", [0, 1]
        path.write_text(json.dumps(dict(reversed(values.items()))))
        return "harmless"
    if how == "activation":
        values["NetworkSpecs"][pick(("activation", "nonlinearity", "geometric_init"), rng)] = "elu"
    path.write_text(json.dumps(mutate_values(values, rng) if how == "values" else values))
    return str(how)


register(
    InputKind("decoder", 300, write_decoder, lambda f, rng: mutate_safetensors(f / DECODER, rng), load_small_decoder)
)
register(detector_kind("pointpillars", 120))
register(detector_kind("sst", 80))
register(
    InputKind("vehicle set", 250, write_vehicles, lambda f, rng: mutate_safetensors(f / VEHICLES, rng), load_vehicles)
)
for variant in NETWORKS:
    write = functools.partial(write_experiment, variant=variant)
    mutators: dict[str, Callable[[Path, Rng], str]] = {
        "weights": pth_mutator("ModelParameters", "model_state_dict"),
        "codes": pth_mutator("LatentCodes", "latent_codes"),
        "specs": mutate_specs,
    }
    for part, mutate in mutators.items():
        register(InputKind(f"DeepSDF {part}, {variant}", 80, write, mutate, load_any_experiment))
