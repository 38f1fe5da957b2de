"""Meshes from files as training shapes: sampled once, refused by name, trained on, and written as a vehicle set."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder
from shift3d.store.arrays import write_arrays
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.sdf.on_meshes import (
    SAMPLES_A_SHAPE,
    SEED,
    MeshShapes,
    export_mesh_training,
    is_exported,
    mesh_recipe,
    mesh_shapes,
)
from shift3d.training.sdf.train import SdfRecipe, train_sdf
from shift3d.vehicles.mesh_files import MeshFile, MeshVehicle, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.vehicle_set import FittedVehicle, write_vehicle_set

FRAME = MeshFrame("+x", "+z", "m")
SAMPLES = 800


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box and a ball of a car's size, and an open sheet; tests only read it."""
    root = tmp_path_factory.mktemp("shapes") / "meshes"
    root.mkdir()
    trimesh.creation.box((4.0, 1.8, 1.4)).export(root / "suv_box.ply")
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.apply_scale([2.2, 1.0, 0.8])
    ball.export(root / "egg.stl")
    sheet().export(root / "sheet.ply")
    return root


def sheet() -> trimesh.Trimesh:
    """Return a sheet that encloses nothing; small, because a mesh with gaps is wrapped first."""
    return trimesh.Trimesh([[0, 0, 0], [2.5, 0, 0.2], [2.5, 0.3, 0], [0, 0.3, 0.2]], [[0, 1, 2], [0, 2, 3]])


def sampled(folder: Path, seed: int = 1) -> MeshShapes:
    return mesh_shapes(folder, FRAME, SAMPLES, seed, folder.parent / "cache", 1)


@pytest.fixture(scope="module")
def sampled_once(folder: Path) -> tuple[MeshShapes, str]:
    """The shapes of the folder, and the text printed by their sampling."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        return sampled(folder), printed.getvalue()


@pytest.fixture
def shapes(sampled_once: tuple[MeshShapes, str]) -> MeshShapes:
    return sampled_once[0]


def test_usable_meshes_are_sampled_and_the_others_named(folder: Path, sampled_once: tuple[MeshShapes, str]) -> None:
    shapes, printed = sampled_once
    assert [facts["name"] for facts in shapes.facts] == ["egg", "suv_box"]
    assert [facts["body_type"] for facts in shapes.facts] == ["vehicle", "suv"]
    assert list(shapes.refused) == [str(folder / "sheet.ply")]
    assert "encloses no solid" in shapes.refused[str(folder / "sheet.ply")]
    assert "left out" in printed
    assert shapes.samples.points.shape == (2, SAMPLES, 3)
    points, scale = shapes.samples.points[1].astype(np.float64), shapes.samples.scale_m[1]
    q = np.abs(points) * scale - np.array([2.0, 0.9, 0.7])
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    assert shapes.samples.distances[1] * scale == pytest.approx(exact, abs=1e-5)


def test_samples_are_kept_until_a_mesh_or_the_seed_changes(
    folder: Path, sampled_once: tuple[MeshShapes, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, _ = sampled_once
    again = sampled(folder)
    assert capsys.readouterr().out == ""
    assert again.samples.source == first.samples.source
    assert np.array_equal(again.samples.points, first.samples.points)
    assert again.facts == first.facts
    mine = tmp_path / "meshes"
    mine.mkdir()
    sources = []
    for length_m, seed in ((4.0, 1), (4.0, 2), (4.1, 1)):
        trimesh.creation.box((length_m, 1.8, 1.4)).export(mine / "suv_box.ply")
        sources.append(sampled(mine, seed).samples.source)
    assert len(set(sources)) == 3


def test_killed_sampling_resumes_and_a_new_mesh_is_sampled_alone(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The samples are those of an uninterrupted call."""
    mine, begun = shutil.copytree(folder, tmp_path / "meshes"), []

    def read(file: MeshFile, frame: MeshFrame) -> MeshVehicle:
        begun.append(file.name)
        if stop == file.name:
            raise KeyboardInterrupt
        return read_mesh_vehicle(file, frame)

    monkeypatch.setattr("shift3d.training.sdf.on_meshes.read_mesh_vehicle", read)
    stop = "suv_box"
    with pytest.raises(KeyboardInterrupt):
        sampled(mine)
    stop = ""
    resumed = sampled(mine)
    assert begun == ["egg", "sheet", "suv_box", "suv_box"]
    assert np.array_equal(resumed.samples.points, sampled(folder).samples.points)
    assert resumed.refused.keys() == {str(mine / "sheet.ply")}
    begun.clear()
    trimesh.creation.box((4.2, 1.8, 1.4)).export(mine / "van.ply")
    (mine / "egg.stl").unlink()
    grown = sampled(mine)
    assert begun == ["van"]
    assert [facts["name"] for facts in grown.facts] == ["suv_box", "van"]
    assert np.array_equal(grown.samples.points[0], resumed.samples.points[1])


def test_samples_of_another_program_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.box((4.0, 1.8, 1.4)).export(tmp_path / "box.ply")

    def points() -> np.ndarray:
        return mesh_shapes(tmp_path, FRAME, SAMPLES, 1, tmp_path, 1).samples.points

    first = points()
    (kept,) = tmp_path.glob("*.npz")
    with np.load(kept) as data:
        write_arrays(kept, **{**data, "points": first[0] + 1.0})
    assert np.array_equal(points(), first + 1.0)
    read, part = Path.read_bytes, "/vehicles/repair.py"
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(part))
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr("shift3d.training.sdf.on_meshes.program_digest", program_digest.__wrapped__, raising=False)
    assert np.array_equal(points(), first)


def test_meshes_that_have_moved_are_found_where_they_are_now(folder: Path, shapes: MeshShapes, tmp_path: Path) -> None:
    moved = shutil.copytree(folder, tmp_path / "elsewhere")
    found = mesh_shapes(moved, FRAME, SAMPLES, 1, folder.parent / "cache", 1)
    assert np.array_equal(found.samples.points, shapes.samples.points), "they are not sampled again"
    assert {Path(facts["file"]).parent for facts in found.facts} == {moved}
    (why,) = found.refused.values()
    assert list(found.refused) == [str(moved / "sheet.ply")] and why.startswith(f"{moved / 'sheet.ply'}: ")


def test_folder_with_nothing_usable_says_why(tmp_path: Path) -> None:
    sheet().export(tmp_path / "sheet.ply")
    with pytest.raises(InputError, match=r"none of 1 meshes.*sheet\.ply"):
        sampled(tmp_path)


def test_training_takes_the_samples_of_its_recipe_and_no_others(shapes: MeshShapes, tmp_path: Path) -> None:
    recipe = dataclasses.replace(mesh_recipe(shapes, steps=2), batch_a_shape=32, compute="float32")
    assert (recipe.shapes, recipe.mirror, recipe.source) == (2, False, shapes.samples.source)
    state = read_checkpoint(train_sdf(tmp_path / "out", recipe, samples=shapes.samples))
    assert state["codes"].shape == (2, 256)
    with pytest.raises(InputError, match="other shapes"):
        train_sdf(tmp_path / "other", SdfRecipe(shapes=2), samples=shapes.samples)


@pytest.mark.parametrize("processes", [1, 2])
def test_decoder_that_has_learnt_nothing_is_not_exported(shapes: MeshShapes, tmp_path: Path, processes: int) -> None:
    recipe = dataclasses.replace(mesh_recipe(shapes, steps=1), batch_a_shape=8, compute="float32")
    checkpoint = train_sdf(tmp_path / "out", recipe, samples=shapes.samples)
    state = read_checkpoint(checkpoint)
    state["decoder"]["layers.8.bias"] = torch.full((1,), 9.0)
    torch.save(state, checkpoint)
    with pytest.raises(InputError, match="no vehicle has a surface"):
        export_mesh_training(checkpoint, shapes, FRAME, tmp_path / "out", processes)
    assert not (tmp_path / "out" / "vehicles.safetensors").exists()


def test_a_vehicle_set_of_this_training_is_not_made_again(shapes: MeshShapes, tmp_path: Path) -> None:
    recipe = dataclasses.replace(mesh_recipe(shapes, steps=1), batch_a_shape=8, compute="float32")
    checkpoint = train_sdf(tmp_path, recipe, samples=shapes.samples)
    assert not is_exported(checkpoint, tmp_path)
    egg = FittedVehicle("egg", "vehicle", (0.0,) * 256, 2.0, ((-1.0,) * 3, (1.0,) * 3), 1, 0.01)
    made = {"recipe": dataclasses.asdict(recipe), "step": 1, "vehicles": [{"name": "egg", "chamfer_cm": 1.0}]}
    for facts, found in ((made, True), ({**made, "step": 2}, False), ({**made, "recipe": {}}, False), ({}, False)):
        write_vehicle_set(tmp_path, Decoder(), [egg], facts)
        assert is_exported(checkpoint, tmp_path) is found
    write_vehicle_set(tmp_path, Decoder(), [egg], made)
    (tmp_path / "vehicles.safetensors").unlink()
    assert not is_exported(checkpoint, tmp_path), "the vehicles are written last"


def test_the_median_printed_is_that_of_the_vehicle_set(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shapes = mesh_shapes(folder, FRAME, SAMPLES_A_SHAPE, SEED, tmp_path / "shapes", 1)
    recipe = mesh_recipe(shapes, steps=1)
    train_sdf(tmp_path, recipe, samples=shapes.samples)
    apart_cm = {"egg": 1.0, "suv_box": 2.0}
    fitted = [
        FittedVehicle(name, "vehicle", (0.0,) * 256, 2.0, ((-1.0,) * 3, (1.0,) * 3), 1, chamfer_cm / 100)
        for name, chamfer_cm in apart_cm.items()
    ]
    rows = [{"name": name, "chamfer_cm": chamfer_cm} for name, chamfer_cm in apart_cm.items()]
    facts = {"recipe": dataclasses.asdict(recipe), "step": 1, "vehicles": rows}
    write_vehicle_set(tmp_path, Decoder(), fitted, facts)
    words = ["model=sdf", f"vehicles={folder}", "unit=m", "forward=+x", "up=+z", "steps=1", "threads=1", "mlflow=none"]
    assert main(["train", *words, f"out={tmp_path}"]) == 0
    assert json.loads((tmp_path / "sdf.json").read_text())["chamfer_median_cm"] == 1.5
    assert "median 1.50 cm, worst 2.00 cm" in capsys.readouterr().out
