"""The vehicles shipped with a parametric decoder: the parameters in their codes, and its accuracy on them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from shift3d.attack.space import parameter_space
from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.meshes import extract_mesh
from shift3d.vehicles.family.split import SPLIT
from shift3d.vehicles.sources import WIDE, VehicleSet, space_hash, vehicle_hash, vehicle_set_folder
from shift3d.vehicles.vehicle import vehicle_mesh


@pytest.fixture(scope="module")
def wide() -> VehicleSet:
    return VehicleSet(WIDE)


def test_every_body_type_and_both_sides_of_the_split_are_there(wide: VehicleSet) -> None:
    kinds = {part for name in wide.names() for part in name.split("_with_")}
    assert set(SPLIT.types("seen")) | set(SPLIT.types("held_out")) <= kinds
    assert {"roof_box", "tail_bicycles", "open_tailgate", "lifted", "dented", "missing_panels"} <= kinds


def test_vehicles_that_were_never_trained_on_are_drawn_without_a_fit() -> None:
    facts = json.loads((vehicle_set_folder(WIDE) / "sdf.json").read_text())
    unseen_cm = list(facts["unseen_chamfer_cm"].values())
    assert len(unseen_cm) >= 20
    assert np.median(unseen_cm) < 1.0 and max(unseen_cm) < 4.0
    assert np.median(list(facts["chamfer_cm"].values())) < 1.0


@pytest.mark.parametrize("name", ["sedan", "camper"])
def test_a_draw_of_the_parameters_is_one_body_of_the_kinds_size(wide: VehicleSet, name: str) -> None:
    vehicle, box = wide.vehicle(name), wide.parameters(name)
    space = parameter_space(torch.from_numpy(vehicle.latent_code), box)
    column = {parameter: index for index, parameter in enumerate(box.names)}
    u = space.draw(np.random.default_rng(3), 0.0)
    mesh = extract_mesh(wide.decoder().field(space.code(u)), 65)
    parts = mesh.split(only_watertight=False)
    assert max(part.area for part in parts) > 0.99 * mesh.area
    length_m = float(np.ptp(mesh.vertices[:, 0])) * vehicle.scale_m
    assert length_m == pytest.approx(vehicle.size_m[0], rel=0.25)
    heights = []
    for end in (-1.0, 1.0):
        u = space.start.clone()
        u[column["chassis.height_m"]] = end
        heights.append(float(np.ptp(extract_mesh(wide.decoder().field(space.code(u)), 33).vertices[:, 2])))
    assert (heights[1] - heights[0]) * vehicle.scale_m > 0.02


def test_the_hash_of_a_space_tells_what_bounds_a_search(wide: VehicleSet) -> None:
    assert space_hash(wide, "sedan", "free") == ""
    hashes = {space_hash(wide, name, "parameters") for name in ("sedan", "suv")} | {space_hash(wide, "sedan", "pca")}
    assert len(hashes) == 3
    assert space_hash(VehicleSet(WIDE), "sedan", "parameters") in hashes
    over_kinds = {space_hash(wide, name, "family") for name in ("sedan", "suv")}
    assert len(over_kinds) == 1 and not over_kinds & hashes
    shipped = VehicleSet()
    without_parameters = {space_hash(shipped, "suv", space) for space in ("family", "pca")}
    assert len(without_parameters | over_kinds | hashes) == 6
    assert space_hash(shipped, "sedan", "family") in without_parameters


def test_vehicles_of_codes_alone_have_no_parameters() -> None:
    with pytest.raises(
        InputError, match=r"'suv' is made of no parameters\. Give vehicle=wide, or attack\.space=pca or free"
    ):
        VehicleSet().parameters("suv")


def test_a_drawn_vehicle_lies_in_its_kinds_ranges_and_is_decoded_once_a_machine_or_again_where_its_file_is_torn(
    wide: VehicleSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class NeverDecoding(VehicleSet):
        def decoder(self) -> Decoder:
            raise AssertionError("decoded again")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kind, box, drawn = wide.vehicle("trailer"), wide.parameters("trailer"), VehicleSet(WIDE).vehicle("trailer-2")
    assert vehicle_hash(NeverDecoding(WIDE).vehicle("trailer-2")) == vehicle_hash(drawn)
    (kept,) = tmp_path.rglob("drawn/*")
    kept.write_bytes(kept.read_bytes()[:-1])
    assert vehicle_hash(VehicleSet(WIDE).vehicle("trailer-2")) == vehicle_hash(drawn)
    own = wide.parameters("trailer-2")
    assert wide.is_parametric("trailer-2") and "trailer-2" not in wide.names()
    assert ((own.low <= own.start) & (own.start <= own.high)).all() and (own.start != box.start).any()
    from_kind = parameter_space(torch.from_numpy(kind.latent_code), box)
    u = parameter_space(torch.from_numpy(drawn.latent_code), own).start
    torch.testing.assert_close(from_kind.code(u), torch.from_numpy(drawn.latent_code), rtol=0.0, atol=1e-6)
    surface = vehicle_mesh(drawn, wide.decoder(), resolution=129)  # as measured
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), drawn.size_m, atol=1e-3)
    np.testing.assert_allclose(np.mean(surface.bounds, axis=0), 0.0, atol=1e-3)
    assert (own.start != wide.parameters("trailer-1").start).any()


def test_only_kinds_made_of_parameters_are_drawn_from() -> None:
    with pytest.raises(InputError, match=r"unknown vehicle 'suv-1'.*Choose from coupe"):
        VehicleSet().vehicle("suv-1")


@pytest.mark.parametrize("name", ["trailer-0", "trailer-", "trailer-02", "lorry-1", "trailer-1-1"])
def test_a_name_that_counts_no_drawn_vehicle_is_unknown(wide: VehicleSet, name: str) -> None:
    with pytest.raises(InputError, match=f"unknown vehicle '{name}'"):
        wide.vehicle(name)
