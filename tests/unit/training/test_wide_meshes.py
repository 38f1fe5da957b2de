"""The wide family as mesh files: read back as they were built, named by kind, and written once."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from shift3d.cli.commands.train import COMMAND
from shift3d.errors import InputError
from shift3d.training.sdf.wide_meshes import SEED, WIDE_FRAME, samples_a_shape, write_wide_meshes
from shift3d.vehicles.family.wide import wide_vehicle
from shift3d.vehicles.mesh_files import find_meshes
from shift3d.vehicles.mesh_vehicle import read_mesh_vehicle


def test_files_hold_the_vehicles_and_are_kept(tmp_path: Path) -> None:
    folder = write_wide_meshes(tmp_path, 2)
    files = {file.name: file for file in find_meshes(folder)}
    for index in range(2):
        spec = wide_vehicle(index, SEED)
        read = read_mesh_vehicle(files[f"{spec.kind.replace('+', '-')}-{index:05d}"], WIDE_FRAME)
        np.testing.assert_allclose(read.size_m, spec.size_m, atol=1e-4)
        assert read.body_type == spec.body_type and read.mesh.is_watertight
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert write_wide_meshes(tmp_path, 2) == folder
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_many_shapes_share_the_samples() -> None:
    assert samples_a_shape(10) == 100_000
    assert 1_000 * samples_a_shape(1_000) == 20_000_000


@pytest.mark.parametrize("word", ["unit=m", "scenes=kitti"])
def test_words_for_files_and_for_detectors_are_refused(word: str) -> None:
    words = ["model=sdf", "vehicles=wide", word]
    with pytest.raises(InputError, match=word.partition("=")[0]):
        COMMAND.run(argparse.Namespace(words=words))
