"""Vehicles of a sweep from files: an experiment whose surface is known in closed form, and the shipped set."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from shift3d.errors import InputError
from shift3d.sdf.decoder import load_decoder, save_decoder
from shift3d.vehicles import vehicle as vehicle_module
from shift3d.vehicles.deepsdf_vehicles import DeepSdfVehicles
from shift3d.vehicles.sources import VehicleSet, space_hash, vehicle_hash, vehicle_set_folder
from shift3d.vehicles.vehicle import BASELINES, DEFAULT_VEHICLES, vehicle_mesh

HALF = np.array([0.35, 0.25, 0.9])  # sdf units: x width, y up, z length
CENTRE = np.array([1.0, -2.0, 2.0]) / 64.0  # nodes of the measuring grid: an octahedron has sharp tips
NAMES = ("van_1", "van_2", "suv_1")


def write_octahedra(folder: Path) -> Path:
    """Write g = tanh(0.2 (sum |x - centre| / half - 1 - z0 / 10)): an octahedron that grows with code number z0.

    Codes are (0, ...), (1, ...) and (2, ...), each with a second number of 1 that has no effect.
    """
    (folder / "ModelParameters").mkdir(parents=True)
    (folder / "LatentCodes").mkdir()
    state = {f"module.lin{i}.weight": torch.zeros(shape) for i, shape in enumerate([(9, 7), (16, 16), (1, 16)])}
    state |= {f"module.lin{i}.bias": torch.zeros(size) for i, size in enumerate([9, 16, 1])}
    for axis in range(3):
        for sign, row in ((1.0, 2 * axis), (-1.0, 2 * axis + 1)):
            state["module.lin0.weight"][row, 4 + axis] = sign
            state["module.lin0.bias"][row] = -sign * CENTRE[axis]
            state["module.lin1.weight"][0, row] = 1.0 / HALF[axis]
    state["module.lin1.weight"][0, 9] = -0.1
    state["module.lin1.bias"][0] = -1.0
    state["module.lin1.weight"][1] = -state["module.lin1.weight"][0]
    state["module.lin1.bias"][1] = 1.0
    state["module.lin2.weight"][0, :2] = torch.tensor([0.2, -0.2])
    specs = {"NetworkArch": "deep_sdf_decoder", "CodeLength": 4, "Instances": list(NAMES)}
    (folder / "specs.json").write_text(json.dumps({**specs, "NetworkSpecs": {"dims": [16, 16], "latent_in": [1]}}))
    torch.save({"epoch": 1, "model_state_dict": state}, folder / "ModelParameters" / "latest.pth")
    codes = torch.tensor([[0.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [2.0, 1.0, 0.0, 0.0]])
    torch.save({"epoch": 1, "latent_codes": {"weight": codes}}, folder / "LatentCodes" / "latest.pth")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_octahedra(tmp_path_factory.mktemp("experiment"))


def test_a_search_over_a_checkpoints_vehicles_is_refused_before_each_is_decoded(folder: Path) -> None:
    with pytest.raises(InputError, match=r"attack\.space=family.*has to be decoded.* attack\.space=pca or free"):
        space_hash(DeepSdfVehicles(folder), "van_1", "family")


def test_scale_axes_and_centre_by_hand(folder: Path) -> None:
    vehicle = DeepSdfVehicles(folder, length_m=4.5).vehicle("van_1")
    # The nose is at -z: x_object = -z, y_object (left) = -x, z_object (up) = +y. 4.5 m are 1.8 units.
    assert vehicle.scale_m == pytest.approx(2.5, abs=0.005)
    assert vehicle.size_m == pytest.approx((4.5, 0.7 * 2.5, 0.5 * 2.5), abs=0.01)
    nose, left, roof = np.diag([2.25, 0.875, 0.625])
    expected = CENTRE + np.array([[0, 0, -0.9], [-0.35, 0, 0], [0, 0.25, 0]])
    assert vehicle.to_sdf(np.stack([nose, left, roof])) == pytest.approx(expected, abs=0.004)
    assert vehicle.name == "van_1"
    assert np.linalg.det(vehicle.sdf_R_object) == pytest.approx(1.0)


def test_the_mesh_of_such_a_vehicle_fills_its_box(folder: Path) -> None:
    source = DeepSdfVehicles(folder, length_m=4.5)
    vehicle = source.vehicle("van_2")
    mesh = vehicle_mesh(vehicle, source.decoder(), resolution=129)
    assert mesh.extents == pytest.approx(vehicle.size_m, abs=0.002)
    assert np.abs(mesh.bounds.mean(axis=0)).max() < 0.002
    assert mesh.volume > 0


def test_a_shape_too_small_for_its_length_is_named(folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    codes = torch.load(copy / "LatentCodes" / "latest.pth", weights_only=True)
    codes["latent_codes"]["weight"][0, 0] = -5.0  # half as long: 20 m are 0.9 units
    torch.save(codes, copy / "LatentCodes" / "latest.pth")
    assert DeepSdfVehicles(copy, length_m=17.0).vehicle("van_1").size_m[0] == pytest.approx(17.0, abs=0.01)
    with pytest.raises(InputError, match=r"copy, van_1: .*0\.9 long.*scale_m 22\.\d+ is above 20.*vehicle\.length_m"):
        DeepSdfVehicles(copy, length_m=20.0).vehicle("van_1")


def test_lengths_by_the_beginning_of_a_name(folder: Path) -> None:
    source = DeepSdfVehicles(folder, length_m={"default": 4.0, "van": 5.0, "van_2": 5.5})
    assert [source.vehicle(name).size_m[0] for name in NAMES] == pytest.approx([5.0, 5.5, 4.0], abs=2e-3)
    with pytest.raises(InputError, match=r"length_m says nothing about suv_1.*default"):
        DeepSdfVehicles(folder, length_m={"van": 5.0}).vehicle("suv_1")


def test_codes_are_as_trained_unless_a_length_is_asked_for(folder: Path) -> None:
    plain, scaled = DeepSdfVehicles(folder), DeepSdfVehicles(folder, code_norm=0.8)
    code, longer = (torch.from_numpy(source.vehicle("suv_1").latent_code) for source in (plain, scaled))
    assert code.tolist() == [2.0, 1.0, 0.0, 0.0]
    mean = (1.0 + np.sqrt(2.0) + np.sqrt(5.0)) / 3.0
    assert longer.numpy() == pytest.approx(code.numpy() * 0.8 / mean)
    points = torch.rand(30, 3) * 2 - 1
    there, here = scaled.decoder().field(longer)(points), plain.decoder().field(code)(points)
    assert torch.allclose(there, here, atol=1e-6)
    assert scaled.vehicle("suv_1").size_m == pytest.approx(plain.vehicle("suv_1").size_m, abs=0.002)


def test_whatever_changes_a_result_changes_a_hash(folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    start = DeepSdfVehicles(folder)
    assert DeepSdfVehicles(copy).decoder_hash() == start.decoder_hash()
    assert vehicle_hash(DeepSdfVehicles(copy).vehicle("van_1")) == vehicle_hash(start.vehicle("van_1"))
    assert vehicle_hash(DeepSdfVehicles(folder, length_m=4.6).vehicle("van_1")) != vehicle_hash(start.vehicle("van_1"))
    turned = DeepSdfVehicles(folder, forward="+z").vehicle("van_1")
    assert vehicle_hash(turned) != vehicle_hash(start.vehicle("van_1"))
    assert DeepSdfVehicles(folder, code_norm=1.0).decoder_hash() != start.decoder_hash()
    codes = torch.load(copy / "LatentCodes" / "latest.pth", weights_only=True)
    codes["latent_codes"]["weight"][0, 0] = 0.01
    torch.save(codes, copy / "LatentCodes" / "latest.pth")
    assert DeepSdfVehicles(copy).decoder_hash() != start.decoder_hash()


def test_what_cannot_be_used_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match=r"unknown vehicle 'tram'.*Choose from van_1, van_2, suv_1"):
        DeepSdfVehicles(folder).vehicle("tram")
    with pytest.raises(InputError, match=r"van_1: longest along z, not along vehicle.forward=\+x.*\+z or -z"):
        DeepSdfVehicles(folder, forward="+x").vehicle("van_1")
    with pytest.raises(InputError, match="lie on one axis"):
        DeepSdfVehicles(folder, forward="+y")
    with pytest.raises(InputError, match=r"length_m=450 is no vehicle's"):
        DeepSdfVehicles(folder, length_m=450.0)
    with pytest.raises(InputError, match=r"specs\.json: no such file"):
        DeepSdfVehicles(folder / "nowhere").names()


def test_the_shipped_vehicles_are_a_set_like_any_other(tmp_path: Path) -> None:
    shipped = VehicleSet()
    assert tuple(shipped.names()) == BASELINES
    for name in ("vehicles.safetensors", "sdf.safetensors"):
        shutil.copy(DEFAULT_VEHICLES.parent / name, tmp_path / name)
    own = VehicleSet(tmp_path)
    assert vehicle_hash(own.vehicle("suv")) == vehicle_hash(shipped.vehicle("suv"))
    assert own.decoder_hash() == shipped.decoder_hash()
    with pytest.raises(InputError, match="unknown vehicle 'tram'"):
        own.vehicle("tram")
    (tmp_path / "sdf.safetensors").unlink()
    with pytest.raises(InputError, match=r"sdf\.safetensors: no such file"):
        own.decoder_hash()


def test_a_box_that_contradicts_the_decoded_shape_is_refused(tmp_path: Path) -> None:
    for name in ("vehicles.safetensors", "sdf.safetensors"):
        shutil.copy(DEFAULT_VEHICLES.parent / name, tmp_path / name)
    VehicleSet(tmp_path).check_size("suv")
    file = tmp_path / "vehicles.safetensors"
    with safe_open(str(file), framework="np") as opened:
        metadata = dict(opened.metadata())
    tensors, before = load_file(file), json.loads(metadata["baselines"])["suv"]

    def check(**changed: list[float]) -> None:
        facts = json.dumps(json.loads(metadata["baselines"]) | {"suv": before | changed})
        save_file(tensors, file, metadata=metadata | {"baselines": facts})
        VehicleSet(tmp_path).check_size("suv")

    length, width, height = before["size_m"]
    check(size_m=[length + 0.04, width - 0.04, height])  # each face is 2 cm off, within a node spacing of 4 cm
    for size in ([length + 0.1, width, height], [length, width, height - 0.1]):
        with pytest.raises(InputError, match=r"vehicles\.safetensors: 'suv': .*ends 0\.05 m off its box of size_m"):
            check(size_m=size)
    with pytest.raises(InputError, match=r"ends 0\.2\d m off its box"):
        check(sdf_t_object=[0.0, 0.0, before["sdf_t_object"][2] + 0.1])
    other = load_decoder()
    with torch.no_grad():
        list(other.parameters())[-1].fill_(0.5)  # half the unit sphere away from any surface
    save_decoder(other, tmp_path / "sdf.safetensors")
    with pytest.raises(InputError, match=r"'suv': its code decodes to no surface.*sdf\.safetensors of these vehicles"):
        check()


def test_a_real_car_stands_on_its_wheels_nose_first(
    real_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pickup's bed, behind, is lower than its cab; its size is a car's."""
    monkeypatch.setattr(vehicle_module, "MEASURED_RESOLUTION", 49)
    source = DeepSdfVehicles(real_data("decoder"))
    (name,) = (name for name in source.names() if name.startswith("pickup_28d"))
    vehicle = source.vehicle(name)
    assert vehicle.size_m[0] == pytest.approx(4.5, abs=1e-3)
    assert 1.5 < vehicle.size_m[1] < 2.2 and 1.2 < vehicle.size_m[2] < 2.2
    field = source.decoder().field(torch.from_numpy(vehicle.latent_code))
    high = np.array([[x, 0.0, 0.25 * vehicle.size_m[2]] for x in (0.3, -1.6)])
    cab, bed = field(torch.from_numpy(vehicle.to_sdf(high))).tolist()
    assert cab < 0.0 < bed


def test_a_folder_that_has_the_name_of_the_shipped_set_is_not_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert vehicle_set_folder("wide").name == "wide" and vehicle_set_folder("wide").is_absolute()
    (tmp_path / "wide").mkdir()
    (tmp_path / "wide" / "vehicles.safetensors").write_bytes(b"")
    with pytest.raises(InputError, match="Rename the folder"):
        vehicle_set_folder("wide")
