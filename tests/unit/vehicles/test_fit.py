"""A mesh auto-decoded into a vehicle set that a sweep can read."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from octahedron_decoder import octahedron_decoder

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder, load_decoder, save_decoder
from shift3d.sdf.meshes import symmetric_chamfer
from shift3d.seeding import generator
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.vehicles import fit, orientation, vehicle_set
from shift3d.vehicles.family import build_mesh, sample_spec
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.orientation import frames_along, reorient_points
from shift3d.vehicles.sources import VehicleSet
from shift3d.vehicles.vehicle import baseline_vehicles, family_vehicles, vehicle_mesh


@pytest.fixture(scope="module")
def mesh() -> trimesh.Trimesh:
    """A vehicle of the family that the decoder was not trained on."""
    return build_mesh(sample_spec("hatchback", generator("fit test")), resolution_m=0.05)


@pytest.fixture
def hatchback(mesh: trimesh.Trimesh, tmp_path: Path) -> Path:
    """The mesh as a file in millimetres, nose along -z, roof along +y."""
    x, y, z = np.asarray(mesh.vertices).T * 1000.0
    file = tmp_path / "hatchback of mine.obj"
    trimesh.Trimesh(np.column_stack([-y, z, -x]), mesh.faces).export(file)
    return file


def test_fitted_mesh_is_a_vehicle_like_those_that_ship(
    mesh: trimesh.Trimesh,
    hatchback: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(vehicle_set, "RESOLUTION", 65)
    monkeypatch.setattr(orientation, "STEPS", 15)
    out = tmp_path / "set"
    assert main(["fit", str(hatchback), "unit=mm", f"out={out}", "steps=40"]) == 0
    captured = capsys.readouterr()
    stages = ["measuring distances", "searching its code, 40 steps", "drawing the code", "trying other orientations"]
    lines = captured.err.splitlines()
    assert "1 vehicle in" in captured.out and len(lines) == len(stages), "no doubts"
    assert all(line.startswith(f"hatchback_of_mine: {stage}") for line, stage in zip(lines, stages, strict=True))
    (vehicle,) = baseline_vehicles(out / "vehicles.safetensors").values()
    assert vehicle.name == "hatchback_of_mine"
    assert vehicle.size_m == pytest.approx(tuple(np.ptp(mesh.vertices, axis=0)), abs=0.12)
    decoded = vehicle_mesh(vehicle, load_decoder(out / "sdf.safetensors"), resolution=65)
    assert decoded.bounds.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    chamfer_cm = 100 * symmetric_chamfer(decoded, mesh, generator("fit test chamfer"), 4000)
    facts = json.loads((out / "sdf.json").read_text())
    assert facts["vehicles"][0]["chamfer_cm"] == pytest.approx(chamfer_cm, abs=1.0)
    assert chamfer_cm < 3.0
    assert (out / "pictures" / "hatchback_of_mine.png").stat().st_size > 1000
    (trained,) = family_vehicles(out / "vehicles.safetensors")
    assert np.array_equal(trained.latent_code, vehicle.latent_code)
    assert VehicleSet(out).decoder_hash() == VehicleSet().decoder_hash(), "a pool of the shipped vehicles serves it"


def test_an_upside_down_mesh_is_said_to_fit_better_the_right_way_up(
    hatchback: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "SAMPLES", 10_000)
    monkeypatch.setattr(vehicle_set, "RESOLUTION", 33)
    monkeypatch.setattr(orientation, "STEPS", 15)
    out = tmp_path / "set"
    main(["fit", str(hatchback), "unit=mm", "up=-y", "steps=30", f"out={out}"])
    assert "hatchback_of_mine: fits better with up=+y: " in capsys.readouterr().err
    (facts,) = json.loads((out / "sdf.json").read_text())["vehicles"]
    assert facts["better_orientation"]["chamfer_cm"] < 0.8 * facts["chamfer_cm"]


def contents(folder: Path, below: str = "*") -> dict[str, tuple[int, bytes]]:
    """Return files of a folder by name: time of writing, and bytes."""
    files = [file for file in folder.rglob(below) if file.is_file() and not file.name.startswith(".")]
    return {str(file.relative_to(folder)): (file.stat().st_mtime_ns, file.read_bytes()) for file in files}


@pytest.fixture
def coarse(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> str:
    """A small decoder, and settings for short fits, here and (by the returned source) in another process."""
    file = tmp_path_factory.mktemp("decoder") / "sdf.safetensors"
    save_decoder(octahedron_decoder(), file)
    values = {"fit.DEFAULT_WEIGHTS": file, "fit.SAMPLES": 2_000, "vehicle_set.RESOLUTION": 33, "orientation.STEPS": 1}
    for name, value in values.items():
        monkeypatch.setattr(f"shift3d.vehicles.{name}", value)
    settings = "; ".join(f"{name} = {value!r}" for name, value in values.items())
    return f"from pathlib import PosixPath; from shift3d.vehicles import fit, orientation, vehicle_set; {settings}"


def test_what_closing_took_and_what_the_decoder_cannot_draw_are_said_with_a_picture_and_an_exit_code(
    tmp_path: Path, coarse: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cube = trimesh.creation.box((4.0, 4.0, 4.0))
    cube.update_faces(np.arange(len(cube.faces)) > 0)
    cube.export(tmp_path / "cube.ply")
    assert main(["fit", str(tmp_path / "cube.ply"), "unit=m", "steps=1", f"out={tmp_path / 'set'}"]) == 3
    printed = capsys.readouterr()
    assert "cube: mesh not closed (3 open edges); 1 hole filled, the widest 565.7 cm" in printed.out
    assert "cube: far from its mesh" in printed.err and "is usual for a car of this length" in printed.err
    assert str(tmp_path / "set" / "pictures" / "cube.png") in printed.err
    assert (tmp_path / "set" / "pictures" / "cube.png").stat().st_size > 1000


def test_a_killed_fit_keeps_each_mesh_and_ends_as_one_that_was_not(
    tmp_path: Path, coarse: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "broken.ply").write_text("none")
    for height_m, name in ((1.0, "a"), (1.5, "b")):
        trimesh.creation.box((2.0, height_m, 4.0)).export(tmp_path / "meshes" / f"{name}.ply")
    out, words = tmp_path / "killed", ["fit", str(tmp_path / "meshes"), "unit=m", "steps=2"]
    run = f"import sys; from shift3d.cli.main import main; {coarse}; main(sys.argv[1:])"
    process = subprocess.Popen([sys.executable, "-c", run, *words, f"out={out}"], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not contents(out):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    left = contents(out)
    assert left and all(name.startswith("kept/") for name in left), "nothing that a sweep would take"
    code = main([*words, f"out={out}"])
    assert f" {len(left)}/3 " in capsys.readouterr().err
    assert left.items() <= contents(out).items(), "what was kept is not fitted again"
    resumed = {name: content for name, (_, content) in contents(out).items()}
    assert main([*words, f"out={tmp_path / 'whole'}"]) == code
    assert {name: content for name, (_, content) in contents(tmp_path / "whole").items()} == resumed
    assert VehicleSet(out).names() == ["a", "b"] and len(resumed) == 3 + 2 + 3


def test_a_refused_mesh_is_not_searched_again_until_it_changes(
    tmp_path: Path, coarse: str, capsys: pytest.CaptureFixture[str]
) -> None:
    meshes, out = tmp_path / "meshes", tmp_path / "set"
    meshes.mkdir()
    trimesh.creation.box((2.0, 1.5, 4.0)).export(meshes / "a.ply")
    trimesh.creation.box((200.0, 150.0, 400.0)).export(meshes / "b.ply")
    (meshes / "c.ply").write_text("none")
    words = ["fit", str(meshes), "unit=m", "steps=1", f"out={out}"]

    def searched() -> tuple[int, list[str], dict[str, str]]:
        """Run the fit. Returns the number of meshes that it searched, the lines about refused ones, their reasons."""
        before = contents(out / "kept")
        main(words)
        lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("left out")]
        facts = json.loads((out / "sdf.json").read_text())
        return len(contents(out / "kept").items() - before.items()), lines, facts["refused"]

    first, lines, reasons = searched()
    assert first == 3 and list(reasons) == [str(meshes / "b.ply"), str(meshes / "c.ply")]
    assert lines == [f"left out: {reason}" for reason in reasons.values()]
    assert searched() == (0, lines, reasons)
    trimesh.creation.box((200.0, 150.0, 300.0)).export(meshes / "b.ply")
    again, _, changed = searched()
    assert again == 1 and list(changed) == list(reasons) and "300 m long" in changed[str(meshes / "b.ply")]
    trimesh.creation.box((2.0, 1.5, 4.5)).export(meshes / "b.ply")
    assert searched()[0] == 1 and VehicleSet(out).names() == ["a", "b"]


def test_a_folder_of_refused_meshes_says_so_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in "ab":
        (tmp_path / f"{name}.ply").write_text("none")
    for _ in range(2):
        assert main(["fit", str(tmp_path), "unit=m", f"out={tmp_path / 'set'}"]) == 2
        assert "none of 2 meshes can be used" in capsys.readouterr().err
    for _ in range(2):  # alone, although the folder's fit refused it
        assert main(["fit", str(tmp_path / "a.ply"), "unit=m", f"out={tmp_path / 'set'}"]) == 2
        assert "a.ply: not a readable PLY" in capsys.readouterr().err


def test_a_file_name_that_is_no_utf_8_is_kept_like_any_other(
    tmp_path: Path, coarse: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meshes").mkdir()
    mesh = tmp_path / "meshes" / os.fsdecode(b"caf\xe9.ply")
    mesh.write_bytes(trimesh.creation.box((2.0, 1.0, 4.0)).export(file_type="ply"))
    words = ["fit", str(mesh.parent), "unit=m", "steps=2", f"out={tmp_path / 'set'}"]
    code = main(words)
    kept = contents(tmp_path / "set", "kept/*")
    assert len(kept) == 1 and "searching its code" in capsys.readouterr().err
    assert main(words) == code and contents(tmp_path / "set", "kept/*") == kept
    assert "searching its code" not in capsys.readouterr().err
    (facts,) = json.loads((tmp_path / "set" / "sdf.json").read_text())["vehicles"]
    assert Path(facts["file"]).is_file()


def test_another_mesh_word_decoder_or_program_and_a_damaged_file_are_fitted_again(
    tmp_path: Path, coarse: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cube, out = tmp_path / "cube.ply", tmp_path / "set"
    trimesh.creation.box((4.0, 4.0, 4.0)).export(cube)
    save_decoder(octahedron_decoder(seed=1), tmp_path / "other.safetensors")

    def fitted(*words: str) -> int:
        """Run a fit. Returns the number of entries that it wrote."""
        before = contents(out / "kept")
        main(["fit", str(cube), "unit=m", f"out={out}", *(words or ("steps=1",))])
        return len(contents(out / "kept").items() - before.items())

    assert fitted() == 1 and fitted() == 0
    ((name, (_, content)),) = contents(out / "kept").items()
    (out / "kept" / name).write_bytes(content[:-1])
    assert fitted() == 1 and contents(out / "kept")[name][1] == content
    assert [
        fitted("steps=2"),
        fitted("steps=1", "up=-y"),
        fitted("steps=1", f"decoder={tmp_path / 'other.safetensors'}"),
    ] == [1, 1, 1]
    trimesh.creation.box((3.9, 4.0, 4.0)).export(cube)
    assert fitted() == 1 and fitted() == 0
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith("/autodecode.py"))
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr(fit, "program_digest", program_digest.__wrapped__)
    assert fitted() == 1


def test_a_set_whose_writing_fails_is_none(tmp_path: Path) -> None:
    vehicle = vehicle_set.FittedVehicle("egg", "vehicle", (0.0,) * 256, 2.0, ((-1.0,) * 3, (1.0,) * 3), 1, 0.01)
    vehicle_set.write_vehicle_set(tmp_path, load_decoder(), [vehicle], {})
    (tmp_path / "sdf.json").unlink()
    (tmp_path / "sdf.json").mkdir()
    with pytest.raises(InputError, match=r"sdf\.json"):
        vehicle_set.write_vehicle_set(tmp_path, Decoder(), [vehicle], {})
    with pytest.raises(InputError, match=r"vehicles\.safetensors"):  # of the decoder before
        VehicleSet(tmp_path).names()


def test_orientations_along_an_axis_are_all_eight_and_turn_points_as_their_frames_do() -> None:
    given = MeshFrame("-z", "+y", unit="m")
    frames = frames_along(given)
    assert frames[0] == given and len(set(frames)) == 8 and {frame.forward[1] for frame in frames} == {"z"}
    in_file = np.array([[0.3, -0.2, 1.7]])
    for frame in frames:
        moved = reorient_points(in_file @ given.object_R_file().T, given, frame)
        assert np.allclose(moved, in_file @ frame.object_R_file().T)


def test_metres_where_the_file_has_millimetres_are_one_line_with_the_remedy(
    hatchback: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", str(hatchback), "unit=m", f"out={tmp_path / 'set'}"]) == 2
    printed = capsys.readouterr().err
    assert "hatchback of mine.obj" in printed
    assert "Give unit=mm" in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "set").exists()


def test_set_needs_vehicles_of_different_names(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no vehicles"):
        vehicle_set.write_vehicle_set(tmp_path, load_decoder(), [], {})


def test_a_decoder_that_draws_nothing_or_has_other_codes_is_named(
    hatchback: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = load_decoder()
    with torch.no_grad():
        list(empty.parameters())[-1].fill_(0.5)  # half the unit sphere away from any surface
    save_decoder(empty, tmp_path / "empty.safetensors")
    save_decoder(Decoder(Architecture(code_length=64)), tmp_path / "short.safetensors")
    words = ["unit=mm", "steps=1", f"out={tmp_path / 'set'}"]
    assert main(["fit", str(hatchback), *words, f"decoder={tmp_path / 'empty.safetensors'}"]) == 2
    printed = capsys.readouterr().err
    assert "hatchback of mine.obj: the decoder draws no surface for it" in printed and "another decoder=" in printed
    assert main(["fit", str(hatchback), *words, f"decoder={tmp_path / 'short.safetensors'}"]) == 2
    assert "short.safetensors: codes of length 64" in capsys.readouterr().err
