"""The shipped vehicles: five baselines that decode to one car-sized body each, at the centre of their frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from decoded_baselines import decoded_baseline
from safetensors.numpy import save_file

from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder, load_decoder
from shift3d.vehicles.family import RANGES
from shift3d.vehicles.vehicle import BASELINES, Vehicle, baseline_vehicles, family_vehicles, vehicle_mesh


@pytest.fixture(scope="module")
def decoder() -> Decoder:
    return load_decoder()


def test_frames_by_hand() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    vehicle = Vehicle("v", np.zeros(256, np.float32), 2.0, quarter, np.array([0.1, 0.0, 0.0]), (1, 1, 1))
    nose = np.array([[2.0, 0.0, 1.0]])
    assert vehicle.to_sdf(nose) == pytest.approx(np.array([[0.1, 1.0, 0.5]]))
    assert vehicle.to_object(vehicle.to_sdf(nose)) == pytest.approx(nose)


def test_the_five_baselines_are_there_in_the_papers_order() -> None:
    vehicles = baseline_vehicles()
    assert tuple(vehicles) == BASELINES
    for name, vehicle in vehicles.items():
        assert vehicle.name == name
        assert vehicle.latent_code.shape == (256,)
        assert vehicle.latent_code.dtype == np.float32


@pytest.mark.parametrize("name", BASELINES)
def test_baseline_decodes_to_one_body_of_the_stated_realistic_size(name: str) -> None:
    vehicle, mesh = baseline_vehicles()[name], decoded_baseline(name)
    volumes = sorted((abs(part.volume) for part in mesh.split(only_watertight=False)), reverse=True)
    assert sum(volumes[1:]) < 1e-3 * volumes[0]
    assert mesh.extents == pytest.approx(vehicle.size_m, abs=0.03)
    assert np.abs(mesh.bounds.mean(axis=0)).max() < 0.02
    for size, (low, high) in zip(vehicle.size_m, (RANGES[name][size] for size in ("length_m", "width_m", "height_m"))):
        assert low - 0.06 <= size <= high + 0.06


@pytest.mark.parametrize("name", BASELINES)
def test_field_is_negative_inside_and_positive_far_away(name: str, decoder: Decoder) -> None:
    vehicle = baseline_vehicles()[name]
    field = decoder.field(torch.from_numpy(vehicle.latent_code))
    # Under the seats of a convertible, in the engine of any: 0.3 heights below the middle, a quarter length forward.
    inside = vehicle.to_sdf(np.array([[0.25 * vehicle.size_m[0], 0.0, -0.10 * vehicle.size_m[2]]]))
    assert float(field(torch.from_numpy(inside))) < -0.02
    far = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    assert float(field(far).min()) > 0.0


def test_float64_agrees(decoder: Decoder) -> None:
    code = torch.from_numpy(baseline_vehicles()["suv"].latent_code)
    points = torch.rand(200, 3, generator=torch.Generator().manual_seed(2)) - 0.5
    counterpart = load_decoder().double().field(code.double())(points.double())
    assert decoder.field(code)(points).double().sub(counterpart).abs().max() < 1e-5


def test_a_small_random_change_of_the_code_keeps_the_vehicle(decoder: Decoder) -> None:
    vehicle = baseline_vehicles()["beach_wagon"]
    step = torch.nn.functional.normalize(torch.randn(256, generator=torch.Generator().manual_seed(3)), dim=0)
    mesh = vehicle_mesh(vehicle, decoder, torch.from_numpy(vehicle.latent_code) + 0.2 * step, resolution=65)
    largest = max(mesh.split(only_watertight=False), key=lambda part: len(part.faces))
    assert largest.extents == pytest.approx(vehicle.size_m, abs=0.20)


def test_family_codes_carry_scale_and_size(decoder: Decoder) -> None:
    vehicles = family_vehicles()
    assert len(vehicles) >= 200
    assert {vehicle.name.rpartition("_")[0] for vehicle in vehicles} == set(RANGES)
    mesh = vehicle_mesh(vehicles[7], decoder, resolution=65)
    assert isinstance(mesh, trimesh.Trimesh)
    assert mesh.extents == pytest.approx(vehicles[7].size_m, abs=0.08)


def test_missing_or_broken_files_name_themselves(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.safetensors"):
        baseline_vehicles(tmp_path / "none.safetensors")
    save_file(
        {"suv.latent_code": np.zeros(7, np.float32)}, tmp_path / "short.safetensors", {"baselines": '{"suv": {}}'}
    )
    with pytest.raises(InputError, match=r"short.*suv.latent_code.*\(7,\)"):
        baseline_vehicles(tmp_path / "short.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"12345")
    with pytest.raises(InputError, match=r"bad\.safetensors"):
        family_vehicles(tmp_path / "bad.safetensors")
