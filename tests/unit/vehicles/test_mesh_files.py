"""Meshes from files: found, read, and turned into the object frame; unusable files are refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from solids import wedge, write_shapenet

from shift3d.errors import InputError
from shift3d.vehicles.mesh_files import find_meshes, read_mesh
from shift3d.vehicles.mesh_frame import AXES, MeshFrame


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb", "stl"])
def test_every_format_gives_the_solid_that_was_written(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"car.{suffix}"
    wedge().export(file)
    mesh = read_mesh(file)
    assert mesh.bounds == pytest.approx(wedge().bounds, abs=1e-6)
    assert mesh.volume == pytest.approx(wedge().volume, rel=1e-6)


def test_parts_of_a_scene_stand_where_its_nodes_say(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    lift = trimesh.transformations.translation_matrix([0, 5, 0])
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    scene.add_geometry(trimesh.creation.box((4, 1, 1)), node_name="body")
    scene.add_geometry(trimesh.creation.box((2, 1, 1)), node_name="tower", transform=lift @ turn)
    scene.export(tmp_path / "parts.glb")
    mesh = read_mesh(tmp_path / "parts.glb")
    assert mesh.bounds == pytest.approx(np.array([[-2, -0.5, -0.5], [2, 6, 0.5]]), abs=1e-6)
    assert mesh.volume == pytest.approx(6.0, rel=1e-6)


def test_shapenet_layout_is_recognised_and_other_files_in_it_left_alone(tmp_path: Path) -> None:
    root = write_shapenet(tmp_path, {"b1": wedge(), "a2": wedge()})
    assert [file.name for file in find_meshes(root)] == ["a2", "b1"]
    vehicle = MeshFrame(unit="m").to_object(read_mesh(find_meshes(root)[0].path), "a2")
    expected = MeshFrame("+x", "+z", "m").to_object(wedge(), "wedge")
    assert vehicle.bounds == pytest.approx(expected.bounds, abs=1e-6)
    assert vehicle.center_mass == pytest.approx(expected.center_mass, abs=1e-6)


def test_a_relative_path_into_shapenets_layout_names_the_vehicle_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_shapenet(tmp_path, {"b1": wedge()})
    (model,) = root.rglob("model_normalized.obj")
    monkeypatch.chdir(model.parents[1])
    assert [file.name for file in find_meshes(".")] == ["b1"]


def test_the_hash_of_a_gltf_is_that_of_the_files_it_names_too(tmp_path: Path) -> None:
    def written(mesh: trimesh.Trimesh) -> tuple[bytes, str]:
        for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh)).items():
            (tmp_path / name).write_bytes(content)
        (file,) = find_meshes(tmp_path)
        return file.path.read_bytes(), file.sha256()

    places = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.2, 0.2, 2.0], [0.5, 0.5, 0.5]]
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 4], [2, 0, 3], [4, 3, 1], [4, 2, 3]]
    pyramid = trimesh.Trimesh(places, faces, process=False)
    before = written(pyramid)
    pyramid.vertices[4] = [0.6, 0.6, 0.4]  # within the box, which the .gltf itself states
    after = written(pyramid)
    assert before[0] == after[0] and before[1] != after[1]
    for file in tmp_path.glob("*.bin"):
        file.unlink()
    assert len(find_meshes(tmp_path)[0].sha256()) == 64
    for text in ("{", '{"buffers": [{"uri": "/dev/zero"}]}', '{"buffers": [{"uri": "."}]}', '{"buffers": 3}'):
        (tmp_path / "model.gltf").write_text(text)
        assert len(find_meshes(tmp_path)[0].sha256()) == 64
    (model,) = find_meshes(tmp_path)
    if (cannot_be_read := Path("/proc/self/mem")).is_file():
        (tmp_path / "model.gltf").write_text('{"buffers": [{"uri": "part.bin"}]}')
        (tmp_path / "part.bin").symlink_to(cannot_be_read)
        with pytest.raises(InputError, match=r"part\.bin: cannot be read"):
            model.sha256()
    (tmp_path / "model.gltf").unlink()
    with pytest.raises(InputError, match=r"model\.gltf: cannot be read"):
        model.sha256()


@pytest.mark.parametrize("word", ["null", "true", "NaN"])
def test_a_name_that_settings_take_for_a_value_gets_a_letter_before_it(tmp_path: Path, word: str) -> None:
    wedge().export(tmp_path / f"{word}.ply")
    assert [file.name for file in find_meshes(tmp_path)] == [f"_{word}"]


def test_any_folder_of_meshes_is_named_by_place(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    wedge().export(tmp_path / "old" / "car 1.ply")
    wedge().export(tmp_path / "new.STL", file_type="stl")
    (tmp_path / "notes.txt").write_text("no mesh")
    assert [file.name for file in find_meshes(tmp_path)] == ["new", "old_car_1"]


def test_folders_that_are_links_count_as_what_they_lead_to(tmp_path: Path) -> None:
    store = write_shapenet(tmp_path / "store", {"a": wedge(), "b": wedge()})
    (a, b) = sorted(file.path.parents[1] for file in find_meshes(store))
    mine = write_shapenet(tmp_path / "mine", {"own": wedge()})
    (mine / "c_a").symlink_to(a)
    (mine / "b").symlink_to(b)
    assert [file.name for file in find_meshes(mine)] == ["b", "c_a", "own"]
    (tmp_path / "linked").symlink_to(mine)
    assert [file.name for file in find_meshes(tmp_path / "linked")] == ["b", "c_a", "own"]


def test_links_lead_to_a_folder_once_and_never_round_in_circles(tmp_path: Path) -> None:
    for name in ("cars", "more"):
        (tmp_path / name).mkdir()
        wedge().export(tmp_path / name / f"{name}.ply")
    (tmp_path / "cars" / "all").symlink_to(tmp_path)
    (tmp_path / "a_link").symlink_to(tmp_path / "more")
    assert [file.name for file in find_meshes(tmp_path)] == ["cars_cars", "more_more"]
    assert [file.name for file in find_meshes(tmp_path / "cars")] == ["all_more_more", "cars"]


def test_two_meshes_of_one_name_are_refused(tmp_path: Path) -> None:
    wedge().export(tmp_path / "car.ply")
    wedge().export(tmp_path / "car.stl")
    with pytest.raises(InputError, match="two meshes are named car"):
        find_meshes(tmp_path)


@pytest.mark.parametrize("forward", AXES)
@pytest.mark.parametrize("up", AXES)
def test_every_orientation_brings_nose_left_and_roof_back(forward: str, up: str) -> None:
    if forward[1] == up[1]:
        with pytest.raises(InputError, match="one axis"):
            MeshFrame(forward, up, "m")
        return
    frame = MeshFrame(forward, up, "mm")
    rotation = frame.object_R_file()
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    in_file = wedge()
    in_file.vertices = np.asarray(in_file.vertices) @ rotation * 1000.0 + [7.0, -900.0, 30.0]
    back = frame.to_object(in_file, "file")
    expected = np.asarray(wedge().vertices) - wedge().bounds.mean(axis=0)
    assert np.asarray(back.vertices) == pytest.approx(expected, abs=1e-9)


def test_normalised_mesh_gets_the_length_that_was_given() -> None:
    small = wedge()
    small.apply_scale(0.1)
    vehicle = MeshFrame("+x", "+z", length_m=4.4).to_object(small, "small")
    low, high = vehicle.bounds
    assert high - low == pytest.approx(np.array([4.4, 1.8 * 4.4 / 4.3, 1.4 * 4.4 / 4.3]))
    assert high + low == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize(("factor", "remedy"), [(1000.0, "unit=mm"), (100.0, "unit=cm"), (0.2, "length_m=")])
def test_wrong_unit_is_refused_and_the_right_one_named(factor: float, remedy: str) -> None:
    mesh = wedge()
    mesh.apply_scale(factor)
    with pytest.raises(InputError, match=rf"car\.obj.*m long.*{remedy}"):
        MeshFrame("+x", "+z", "m").to_object(mesh, "car.obj")


def test_wrong_orientation_is_refused_and_the_long_axis_named() -> None:
    with pytest.raises(InputError, match=r"car\.obj: longest along x.*forward=\+x or -x"):
        MeshFrame(unit="m").to_object(wedge(), "car.obj")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"forward": "z", "unit": "m"}, "forward=z"),
        ({}, "scale"),
        ({"unit": "m", "length_m": 4.0}, "scale"),
        ({"unit": "foot"}, "foot"),
        ({"length_m": float("nan")}, "length_m=nan"),
        ({"length_m": -4.0}, "length_m=-4"),
    ],
)
def test_frame_that_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        MeshFrame(**options)  # type: ignore[arg-type]


def test_sheet_has_no_third_dimension() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(InputError, match=r"sheet\.ply: the mesh is flat"):
        MeshFrame("+x", "+z", "m").to_object(sheet, "sheet.ply")


def test_unusable_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "torn.glb").write_bytes(b"glTF\x02\x00\x00\x00 torn")
    (tmp_path / "empty.ply").write_bytes(b"")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    (tmp_path / "vertices.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "beyond.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    for file in sorted(tmp_path.iterdir()):
        with pytest.raises(InputError) as caught:
            read_mesh(file)
        assert file.name in str(caught.value)
        assert caught.value.remedy
    for name, message in (("points.ply", "no faces"), ("vertices.obj", "no faces"), ("nan.obj", "not finite")):
        with pytest.raises(InputError, match=message):
            read_mesh(tmp_path / name)


def test_places_without_meshes_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no meshes below"):
        find_meshes(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        find_meshes(tmp_path / "absent")
    (tmp_path / "car.step").write_text("ISO-10303-21")
    with pytest.raises(InputError, match=r"car\.step: not a mesh file"):
        find_meshes(tmp_path / "car.step")


@pytest.mark.parametrize("length_m", [2.0, 20.0])
def test_the_lengths_at_either_end_are_lengths(length_m: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        box = trimesh.creation.box(extents=np.array([4.0, 0.6, 0.5]) * rng.uniform(0.8, 1.2, 3))
        assert MeshFrame("+x", "+z", length_m=length_m).to_object(box, "box").extents[0] == pytest.approx(length_m)
