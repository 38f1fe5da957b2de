"""Sources of reference sets, their storage, and refused sets."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from vehicles_by_hand import Meshes, legged, on_legs

from shift3d.errors import InputError
from shift3d.naturalness.build import build_reference, load_reference, reference_file
from shift3d.naturalness.measure import NaturalnessMeter
from shift3d.naturalness.reference import read_reference
from shift3d.naturalness.sources import MeshReference, SetReference, WideReference, reference_source, source_hash
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.vehicles.family.split import SPLIT
from shift3d.vehicles.mesh_frame import MeshFrame

METRES = MeshFrame(forward="+x", up="+z", unit="m")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def folder_of(tmp_path: Path, count: int, scale: float = 1.0) -> str:
    folder = tmp_path / f"meshes-{count}-{scale:g}"
    folder.mkdir()
    for number, length in enumerate(np.linspace(3.6, 5.5, count)):
        mesh = on_legs(length_m=float(length))
        mesh.apply_scale(scale)
        mesh.export(folder / f"car_{number:02d}.ply")
    return str(folder)


def test_a_folder_of_meshes_is_a_reference_set(tmp_path: Path) -> None:
    source = MeshReference(folder_of(tmp_path, 21), METRES)
    found = load_reference(source, "here")
    assert found.names[:2] == ("car_00", "car_01") and len(found.calibration.mean_cm) == 21
    nearest = found.nearest(found.surface(7))
    assert nearest.name == "car_07" and nearest.mean_cm < 1e-6


def test_a_set_is_built_once_and_kept_in_one_file(tmp_path: Path) -> None:
    source = MeshReference(folder_of(tmp_path, 21), METRES)
    shape = on_legs(length_m=4.44)
    before = NaturalnessMeter(load_reference(source, "here")).of(shape)
    (kept,) = (tmp_path / "cache").rglob("*.safetensors")
    assert kept == reference_file(source)
    content = kept.read_bytes()
    assert NaturalnessMeter(load_reference(source, "here")).of(shape) == before
    kept.unlink()
    load_reference(source, "here")
    assert kept.read_bytes() == content, "the same bytes when it is made again"


def test_a_damaged_file_is_made_again(tmp_path: Path) -> None:
    source = MeshReference(folder_of(tmp_path, 21), METRES)
    load_reference(source, "here")
    kept = reference_file(source)
    content = kept.read_bytes()
    for damaged in (content[: len(content) // 2], b"", b"{}"):
        kept.write_bytes(damaged)
        with pytest.raises(InputError, match="no reference set can be read"):
            read_reference(kept)
        assert len(load_reference(source, "here")) == 21


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    found = load_reference(legged(np.linspace(3.6, 5.5, 21)), "here")
    assert found.nearest(found.surface(3)).name == "member-3"


@pytest.mark.parametrize("part", ["vehicles/vehicle.py", "vehicles/vehicle_set.py", "sdf/deepsdf_network.py"])
def test_a_set_that_other_code_made_is_made_again(monkeypatch: pytest.MonkeyPatch, part: str) -> None:
    """The code that decodes a member and converts it to metres determines the member."""
    known, read = reference_file(SetReference()), Path.read_bytes
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr("shift3d.naturalness.build.program_digest", program_digest.__wrapped__)
    assert reference_file(SetReference()) == known
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(f"/{part}"))
    assert reference_file(SetReference()) != known


def test_a_set_that_another_library_meshed_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    known = reference_file(SetReference())
    monkeypatch.setattr("shift3d.naturalness.build.program_digest", program_digest.__wrapped__)
    monkeypatch.setattr("importlib.metadata.version", lambda library: "0.0" if library == "scikit-image" else "1.0")
    one = reference_file(SetReference())
    monkeypatch.setattr("importlib.metadata.version", lambda library: "1.0")
    assert known != reference_file(SetReference()) != one


def test_another_file_or_frame_is_another_set(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 21)
    one = source_hash(MeshReference(folder, METRES))
    assert one == source_hash(MeshReference(folder, METRES))
    assert one != source_hash(MeshReference(folder, MeshFrame(forward="-x", up="+z", unit="m")))
    on_legs(0.25).export(Path(folder) / "car_00.ply")
    assert one != source_hash(MeshReference(folder, METRES))
    assert source_hash(WideReference(100)) != source_hash(WideReference(101))


def test_the_wide_family_has_both_sides_and_the_shorter_set_begins_the_longer_one() -> None:
    members, _ = build_reference(WideReference(24, resolution_m=0.15), "here")
    seen = [set(member.name.rpartition("-")[0].split("+")) <= set(SPLIT.seen) for member in members]
    assert seen == [index % 4 != 3 for index in range(24)]
    assert len({member.name for member in members}) == 24
    shorter, _ = build_reference(WideReference(21, resolution_m=0.15), "here")
    assert all(np.array_equal(a.points, b.points) for a, b in zip(shorter, members))


def test_a_set_of_codes_is_a_reference_set() -> None:
    members = SetReference().members()
    name, mesh = members[4]()
    assert len(members) == 270 and name.endswith("_4")
    assert 3.0 < mesh.extents[0] < 6.5


def test_settings_name_a_source() -> None:
    assert reference_source({"kind": "wide", "members": 50}) == WideReference(50)
    assert reference_source({"kind": "set", "folder": None}) == SetReference()
    frame = {"forward": "-z", "up": "+y", "unit": None, "length_m": 4.5}
    assert reference_source({"kind": "meshes", "folder": "f", **frame}) == MeshReference("f", MeshFrame(**frame))


def test_another_unit_is_refused_with_the_one_that_fits(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 21, scale=100.0)
    with pytest.raises(InputError, match="Give unit=cm") as failure:
        build_reference(MeshReference(folder, METRES), "naturalness")
    assert "car_00.ply" in failure.value.where
    build_reference(MeshReference(folder, MeshFrame(forward="+x", up="+z", unit="cm")), "naturalness")


def test_sizes_that_no_vehicle_has_are_refused_whatever_the_unit(tmp_path: Path) -> None:
    """Limousines with the length of a car, and cars of 2.2 m, are within a reader's limits, but are no vehicles."""
    for scale in ((1.0, 0.5, 1.0), (0.55, 0.55, 0.55)):
        meshes = []
        for mesh in legged(np.linspace(3.6, 5.5, 21)).meshes:
            mesh.apply_scale(scale)
            meshes.append(mesh)
        with pytest.raises(InputError, match="21 of 21 members have sizes that no vehicle has") as failure:
            build_reference(Meshes(tuple(meshes)), "naturalness")
        assert "length" in failure.value.remedy


def test_too_few_members_for_a_percentile_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"20 members.*21 vehicles or more"):
        build_reference(MeshReference(folder_of(tmp_path, 20), METRES), "naturalness")


def test_copies_and_links_of_a_mesh_are_no_further_members(tmp_path: Path) -> None:
    """A duplicate vehicle has no distance from the rest of the set: with all vehicles twice no distance is usual."""
    folder = Path(folder_of(tmp_path, 21))
    before = MeshReference(str(folder), METRES).identity()
    (folder / "old").mkdir()
    for number, file in enumerate(sorted(folder.glob("*.ply"))):
        copy = folder / "old" / file.name
        shutil.copy(file, copy) if number % 2 else copy.symlink_to(file)
    source = MeshReference(str(folder), METRES)
    assert source.identity() == before and len(source.members()) == 21
    _, calibration = build_reference(source, "here")
    assert calibration.mean_cm.min() > 0.1


def test_an_empty_or_missing_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder, what in (("empty", "no meshes"), ("none", "no such")):
        with pytest.raises(InputError, match=what):
            source_hash(MeshReference(str(tmp_path / folder), METRES))
        with pytest.raises(InputError, match=r"holds no vehicles\.safetensors"):
            source_hash(SetReference(str(tmp_path / folder)))


def test_a_mesh_that_is_no_vehicle_is_refused_by_name(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 21)
    flat = trimesh.Trimesh([[0, 0, 0], [4, 0, 0], [4, 2, 0]], [[0, 1, 2]], process=False)
    flat.export(Path(folder) / "car_03.ply")
    with pytest.raises(InputError, match="flat") as failure:
        build_reference(MeshReference(folder, METRES), "naturalness")
    assert "car_03.ply" in failure.value.where


def test_the_wide_set_that_ships_goes_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert source_hash(SetReference("wide")) not in (source_hash(SetReference()), None)
    (tmp_path / "wide").mkdir()
    (tmp_path / "wide" / "vehicles.safetensors").touch()
    with pytest.raises(InputError, match="a folder here has the same name") as failure:
        source_hash(SetReference("wide"))
    assert failure.value.where == "naturalness.folder=wide"
