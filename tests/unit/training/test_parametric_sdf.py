"""A decoder whose codes consist of the generator's parameters: samples, training, and its vehicle set."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from shift3d.cli.commands.detectors.train import COMMAND
from shift3d.errors import InputError
from shift3d.sdf.decoder import load_decoder
from shift3d.sdf.samples import signed_distance
from shift3d.store.arrays import write_arrays
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.training.checkpoints import write_checkpoint
from shift3d.training.compute import choose_compute
from shift3d.training.sdf import loop, parametric
from shift3d.training.sdf.parametric import ParametricRecipe, train_parametric
from shift3d.training.sdf.wide_shapes import WideShapes, in_frame, kind_frames, wide_shapes
from shift3d.training.sdf_shapes import shape_samples
from shift3d.vehicles.family.parameters import named_parameters, parameter_table
from shift3d.vehicles.family.wide import build_wide_mesh, wide_family
from shift3d.vehicles.parameter_box import ParameterBox, parameter_tensors, read_parameters

SPECS = [*wide_family(24, 3, "seen"), *wide_family(24, 3, "held_out")]


def test_a_row_says_everything_that_a_vehicle_is_made_of() -> None:
    table = parameter_table(SPECS)
    spread = table.rows(SPECS)
    assert len({row.tobytes() for row in spread}) == len(SPECS)
    for spec, row in zip(SPECS, spread, strict=True):
        for name, value in named_parameters(spec).items():
            column = table.names.index(name)
            assert row[column] * table.spread[column] + table.centre[column] == pytest.approx(value)
        kinds = [name for name, value in zip(table.names, row) if value == 1.0 and name.startswith(("is:", "has:"))]
        assert {name.partition(":")[2] for name in kinds} == {spec.body_type, *spec.attributes}


def test_what_a_vehicle_has_not_is_zero() -> None:
    table = parameter_table(SPECS)
    plain = next(spec for spec in SPECS if spec.kind == "sedan")
    row = dict(zip(table.names, table.row(plain)))
    assert all(value == 0.0 for name, value in row.items() if name.startswith(("RoofBox.", "Bicycles.", "Dents.")))


def test_vehicles_of_a_kind_share_a_frame_that_holds_them_all_and_stand_on_one_ground() -> None:
    frames = kind_frames(SPECS)
    for spec in SPECS[:6] + SPECS[24:36]:
        frame = frames[spec.kind]
        unit = in_frame(spec, frame, build_wide_mesh(spec, 0.06))
        assert np.linalg.norm(unit.vertices, axis=1).max() <= 1.0
        lowest = float(unit.vertices[:, 2].min()) * frame.scale_m + frame.middle_m
        assert lowest == pytest.approx(0.0, abs=1e-5)


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> WideShapes:
    return wide_shapes(4, 600, 3, tmp_path_factory.mktemp("samples"), 1)


def test_samples_are_distances_to_the_mesh_in_the_kinds_frame(shapes: WideShapes) -> None:
    spec = shapes.specs[1]
    unit = in_frame(spec, shapes.frames[spec.kind], build_wide_mesh(spec, 0.035, 30_000))
    expected = signed_distance(unit, shapes.points[1].astype(np.float64))
    np.testing.assert_allclose(shapes.distances[1], expected, atol=1e-5)


@pytest.mark.parametrize("sample", [wide_shapes, shape_samples])
def test_samples_of_another_family_are_made_again(
    sample: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples of the same program are read back from disk."""
    first = sample(2, 60, 3, tmp_path, 1).points
    (kept,) = tmp_path.rglob("*.npz")
    with np.load(kept) as data:
        write_arrays(kept, **{**data, "points": first + 1.0})
    assert np.array_equal(sample(2, 60, 3, tmp_path, 1).points, first + 1.0)
    read, part = Path.read_bytes, "/vehicles/family/solid.py"
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(part))
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr(f"{sample.__module__}.program_digest", program_digest.__wrapped__, raising=False)
    assert np.array_equal(sample(2, 60, 3, tmp_path, 1).points, first)


def test_a_training_that_was_killed_ends_in_the_same_weights(
    shapes: WideShapes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = ParametricRecipe(shapes=4, samples_a_shape=600, shapes_a_step=3, points_a_shape=16, steps=4)
    compute = choose_compute("cpu", 1)
    whole = torch.load(train_parametric(tmp_path / "whole", recipe, shapes, compute), weights_only=True)

    def write_and_die(path: Path, state: dict[str, object]) -> None:
        write_checkpoint(path, state)
        raise MemoryError

    with monkeypatch.context() as killed, pytest.raises(MemoryError):
        killed.setattr(loop, "write_checkpoint", write_and_die)
        train_parametric(tmp_path / "parts", recipe, shapes, compute, checkpoint_every=2)
    file = train_parametric(tmp_path / "parts", recipe, shapes, compute)
    parts = torch.load(file, weights_only=True)
    assert torch.equal(whole["basis"], parts["basis"])
    assert all(torch.equal(whole["decoder"][name], tensor) for name, tensor in parts["decoder"].items())
    with pytest.raises(InputError, match="another recipe"):
        train_parametric(tmp_path / "parts", ParametricRecipe(shapes=4, steps=5), shapes, compute)


def test_too_few_vehicles_to_measure_are_known_before_any_is_sampled(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no kind has 8 members"):
        parametric.train_wide_family(tmp_path / "out", choose_compute("cpu"), count=20, steps=1)
    assert not (tmp_path / "out").exists()


def test_it_starts_as_the_shipped_decoder(shapes: WideShapes, tmp_path: Path) -> None:
    run = parametric.ParametricRun(
        ParametricRecipe(shapes=4, samples_a_shape=600, shapes_a_step=3), shapes, choose_compute("cpu", 1)
    )
    z, x = 0.05 * torch.randn(3, 256), torch.rand(3, 3)
    assert torch.allclose(run.decoder(z, x), load_decoder()(z, x), atol=1e-5)


def box() -> ParameterBox:
    basis = np.eye(2, 256, dtype=np.float32)
    return ParameterBox(basis, np.array([0.0, 0.5]), np.array([-1.0, 0.25]), np.array([1.0, 0.5]), ("a", "b"))


def write(path: Path, found: ParameterBox, names: list[str] | None) -> Path:
    facts = {"suv": {"parameters": names} if names is not None else {}}
    save_file(parameter_tensors("suv", found), path, metadata={"baselines": json.dumps(facts)})
    return path


def test_parameters_come_back_as_they_were_written(tmp_path: Path) -> None:
    read = read_parameters(write(tmp_path / "v.safetensors", box(), ["a", "b"]), "suv")
    assert read.names == ("a", "b") and read.low.tolist() == [-1.0, 0.25] and read.high.tolist() == [1.0, 0.5]
    assert np.array_equal(read.basis, box().basis)


def test_vehicles_without_parameters_or_with_an_empty_range_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'suv' is made of no parameters\. Give vehicle=wide"):
        read_parameters(write(tmp_path / "none.safetensors", box(), None), "suv")
    empty = ParameterBox(box().basis, box().start, np.array([-1.0, 0.6]), box().high, ("a", "b"))
    with pytest.raises(InputError, match="the range of b does not hold the vehicle"):
        read_parameters(write(tmp_path / "empty.safetensors", empty, ["a", "b"]), "suv")
    with pytest.raises(InputError, match=r"suv.parameters.basis"):
        read_parameters(write(tmp_path / "short.safetensors", box(), ["a", "b", "c"]), "suv")


@pytest.mark.parametrize("word", ["unit=m", "scenes=kitti", "finetune=OUT", "method=baseline", "recipe.seed=2"])
def test_words_for_files_and_for_detectors_are_refused(word: str) -> None:
    words = ["model=sdf", "vehicles=wide", "steps=0", word]  # steps=0: nothing is trained
    with pytest.raises(InputError, match=word.partition("=")[0]):
        COMMAND.run(argparse.Namespace(words=words))
