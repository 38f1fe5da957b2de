"""Files that travel with a sweep: a worker loads the driver's files, whatever its machine has."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shift3d.errors import InputError
from shift3d.settings.catalogue.detector_files import file_hash, weights_file
from shift3d.sweep.execution.ray.shipped_files import (
    NamedFiles,
    named_files,
    read_shipped_files,
    with_files_in,
    with_local_files,
)
from shift3d.task.assets import load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.vehicles.sources import VehicleSet

STREETS = {
    "kind": "street", "sensor": "hdl64", "split": "test", "seed": 0, "count": 1,
}  # fmt: skip
SHIPPED = weights_file("sst_small", None).parent


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a user's own vehicles, decoder and detector; and a home without a copy."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("vehicles.safetensors", "sdf.safetensors", "sst_small.safetensors"):
        shutil.copy(SHIPPED / name, folder / name)
    return folder


def own(folder: Path) -> AssetsSpec:
    weights = folder / "sst_small.safetensors"
    return AssetsSpec(
        scenes=STREETS,
        vehicles={"kind": "set", "folder": str(folder)},
        detectors={"sst_small": str(weights), "pointpillars": None},
        hashes={"decoder": VehicleSet(folder).decoder_hash(), "sst_small": file_hash(weights)},
    )


def copies(tmp_path: Path) -> list[str]:
    return sorted(path.name for path in (tmp_path / "home").rglob("*") if path.is_file())


def test_what_lies_here_is_used_where_it_lies(mine: Path, tmp_path: Path) -> None:
    assets = own(mine)
    assert with_local_files(assets, read_shipped_files([assets])) == assets
    assert copies(tmp_path) == []


def test_what_is_not_here_is_loaded_from_the_shipped_files(mine: Path, tmp_path: Path) -> None:
    assets = own(mine)
    shipped = read_shipped_files([assets])
    shutil.rmtree(mine)
    with pytest.raises(InputError, match="sst_small"):
        load_assets(assets)
    found = load_assets(with_local_files(assets, shipped))
    assert "suv" in found.vehicles.names()
    assert copies(tmp_path) == ["sdf.safetensors", "sst_small.safetensors", "vehicles.safetensors"]
    assert (tmp_path / "home" / ".shift3d" / "files").stat().st_mode & 0o077 == 0, "its owner's alone"


def test_a_home_that_cannot_be_written_to_is_named(mine: Path, tmp_path: Path) -> None:
    assets = own(mine)
    shipped = read_shipped_files([assets])
    shutil.rmtree(mine)
    (tmp_path / "home").write_text("a file, no folder")
    with pytest.raises(InputError, match="home that they can write to"):
        with_local_files(assets, shipped)


def test_another_file_of_that_name_is_not_taken_for_it(mine: Path) -> None:
    assets = own(mine)
    shipped = read_shipped_files([assets])
    decoder = mine / "sdf.safetensors"
    decoder.write_bytes(decoder.read_bytes()[:-1] + b"\0")
    moved = with_local_files(assets, shipped)
    assert moved.vehicles["folder"] != str(mine)
    assert moved.detectors == assets.detectors, "this file is as it was"
    load_assets(moved)


def test_a_copy_is_made_once_and_mended_if_it_was_damaged(mine: Path) -> None:
    assets = own(mine)
    shipped = read_shipped_files([assets])
    shutil.rmtree(mine)
    copy = Path(str(with_local_files(assets, shipped).detectors["sst_small"]))
    was = copy.stat()
    assert with_local_files(assets, shipped).detectors["sst_small"] == str(copy)
    assert copy.stat().st_ino == was.st_ino, "not written again"
    copy.write_bytes(b"torn")
    with_local_files(assets, shipped)
    assert file_hash(copy) == assets.hashes["sst_small"]


def test_bytes_out_of_the_object_store_cannot_be_written_to(mine: Path) -> None:
    """Ray maps objects read-only; all code must work on them."""
    assets = own(mine)
    shipped = read_shipped_files([assets])
    for contents in shipped.values():
        for content in contents.values():
            content.setflags(write=False)
    shutil.rmtree(mine)
    load_assets(with_local_files(assets, shipped))


def test_a_deepsdf_experiment_travels_with_its_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    folder = tmp_path / "cars"
    names = ("specs.json", "ModelParameters/2000.pth", "LatentCodes/2000.pth")
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    vehicles = {"kind": "deepsdf", "folder": str(folder), "checkpoint": "2000"}
    assets = AssetsSpec(scenes=STREETS, vehicles=vehicles)
    assert named_files(assets) == (NamedFiles(str(folder), names),)
    shipped = read_shipped_files([assets])
    shutil.rmtree(folder)
    there = Path(with_local_files(assets, shipped).vehicles["folder"])
    assert [(there / name).read_text() for name in names] == list(names)


def test_a_file_that_is_gone_before_it_travels_is_named(mine: Path) -> None:
    assets = own(mine)
    (mine / "sdf.safetensors").unlink()
    with pytest.raises(InputError, match=r"sdf\.safetensors"):
        read_shipped_files([assets])


def test_what_ships_does_not_travel() -> None:
    assert read_shipped_files([AssetsSpec(scenes=STREETS)]) == {}
    assert read_shipped_files([AssetsSpec(scenes=STREETS, vehicles={"kind": "set", "folder": "wide"})]) == {}


@given(st.dictionaries(st.sampled_from(["sst", "sst_small", "pointpillars"]), st.none() | st.just("~/w/a.safetensors")))
def test_only_what_was_asked_for_moves(detectors: dict[str, str | None]) -> None:
    assets = AssetsSpec(scenes=STREETS, detectors=detectors)
    assert with_files_in(assets, {}) == assets
    files = named_files(assets)
    assert files == ((NamedFiles("~/w", ("a.safetensors",)),) if any(detectors.values()) else ())
    moved = with_files_in(assets, {one: Path("/there") for one in files})
    expected = {name: path and "/there/a.safetensors" for name, path in detectors.items()}
    assert moved == dataclasses.replace(assets, detectors=expected)


def test_two_sweeps_with_one_name_and_other_content_do_not_share_a_copy(mine: Path) -> None:
    first = own(mine)
    shipped = read_shipped_files([first])
    other = dict(shipped)
    (weights,) = (files for files in shipped if "sst_small" in files.names[0])
    other[weights] = {name: np.invert(content) for name, content in shipped[weights].items()}
    shutil.rmtree(mine)
    assert (
        with_local_files(first, shipped).detectors["sst_small"] != with_local_files(first, other).detectors["sst_small"]
    )
