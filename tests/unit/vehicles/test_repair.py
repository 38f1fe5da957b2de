"""Repair of meshes: counted defects, unmoved parts, wrapped meshes, and refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from solids import wedge

from shift3d.errors import InputError
from shift3d.sdf.samples import is_closed, sample_sdf, signed_distance
from shift3d.seeding import generator
from shift3d.vehicles.mesh_files import find_meshes, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.repair import RepairReport, close_mesh, correctly_oriented_share

SIZE = (4.0, 1.8, 1.4)
SMALL = (2.0, 1.0, 0.8)  # the grid that bridges gaps has this many nodes per cubic metre


def body(size: tuple[float, float, float] = SIZE, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    box = trimesh.creation.box(size)
    box.apply_translation(at)
    return box


def without_faces(mesh: trimesh.Trimesh, dropped: list[int]) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.delete(mesh.faces, dropped, axis=0), process=False)


def facing(mesh: trimesh.Trimesh, direction: tuple[int, int, int]) -> list[int]:
    return list(np.flatnonzero(np.asarray(mesh.face_normals) @ direction > 0.9))


def test_closed_solid_stays_as_it_is() -> None:
    mesh, report = close_mesh(wedge(), "wedge")
    assert report == RepairReport(watertight=True, open_edges=0)
    assert str(report) == "closed; nothing to repair"
    assert mesh.volume == pytest.approx(4.0 * 1.8 * 1.4 * 0.75 + 0.2**3)


def test_triangles_with_vertices_of_their_own_are_joined() -> None:
    whole = wedge()
    soup = trimesh.Trimesh(np.asarray(whole.triangles).reshape(-1, 3), np.arange(3 * len(whole.faces)).reshape(-1, 3))
    soup = trimesh.Trimesh(soup.triangles.reshape(-1, 3), np.arange(3 * len(whole.faces)).reshape(-1, 3), process=False)
    mesh, report = close_mesh(soup, "soup")
    assert report.merged_vertices == 3 * len(whole.faces) - len(whole.vertices)
    assert report.watertight
    assert mesh.volume == pytest.approx(whole.volume)


def test_repeated_and_collapsed_faces_are_dropped_and_counted() -> None:
    box = body()
    faces = np.concatenate([box.faces, box.faces[:2], [[0, 0, 1]]])
    mesh, report = close_mesh(trimesh.Trimesh(box.vertices, faces, process=False), "box")
    assert report.dropped_faces == 3
    assert len(mesh.faces) == 12
    assert not report.wrapped


def test_inverted_mesh_is_turned_outside_out() -> None:
    inverted = wedge()
    inverted.invert()
    mesh, report = close_mesh(inverted, "inverted")
    assert report.flipped_pieces == 2
    assert mesh.volume == pytest.approx(wedge().volume)
    assert signed_distance(mesh, np.array([[0.0, 0.0, 0.3]]))[0] < 0


def test_one_inverted_piece_is_turned_and_a_cavity_is_not() -> None:
    lamp = body((0.2, 0.2, 0.2), (2.5, 0, 0))
    lamp.invert()
    mesh, report = close_mesh(trimesh.util.concatenate([body(), lamp]), "lamp")
    assert report.flipped_pieces == 1
    assert mesh.volume == pytest.approx(np.prod(SIZE) + 0.008)
    cavity = body((3.0, 1.0, 1.0))
    cavity.invert()
    mesh, report = close_mesh(trimesh.util.concatenate([body(), cavity]), "cavity")
    assert report.flipped_pieces == 0
    assert mesh.volume == pytest.approx(np.prod(SIZE) - 3.0)


def test_windings_that_disagree_are_made_one() -> None:
    box = body()
    faces = np.array(box.faces)
    faces[::3] = faces[::3, ::-1]
    mesh, report = close_mesh(trimesh.Trimesh(box.vertices, faces, process=False), "mixed")
    assert not report.wrapped
    assert mesh.volume == pytest.approx(np.prod(SIZE))


def test_small_holes_are_filled_and_counted() -> None:
    box = body().subdivide().subdivide()
    mesh, report = close_mesh(without_faces(box, [0, 100]), "holes")
    assert (report.watertight, report.open_edges, report.filled_holes, report.wrapped) == (False, 6, 2, False)
    assert report.widest_hole_m == pytest.approx(np.linalg.norm([1.0, 0.45, 0.35]), rel=0.4)
    assert "2 holes filled" in str(report)
    assert is_closed(mesh)
    assert mesh.volume == pytest.approx(np.prod(SIZE))


def test_pieces_that_touch_in_an_edge_are_closed() -> None:
    pair = trimesh.util.concatenate([body((2, 1, 1), (0, 0, 0)), body((2, 1, 1), (2, 1, 0))])
    mesh, report = close_mesh(pair, "pair")
    assert not mesh.is_watertight
    assert not report.wrapped
    points = generator("pair").uniform([-1.5, -1, -0.7], [3.5, 2, 0.7], (2000, 3))
    distances = [
        np.linalg.norm(np.maximum(q := np.abs(points - at) - [1, 0.5, 0.5], 0), axis=1) + np.minimum(q.max(axis=1), 0)
        for at in ((0, 0, 0), (2, 1, 0))
    ]
    assert signed_distance(mesh, points) == pytest.approx(np.minimum(*distances), abs=1e-9)


def panels(gap_m: float, box: tuple[float, float, float] = SIZE) -> trimesh.Trimesh:
    """Return a box as six sheets that end short of its edges, three of them facing inwards, around a seat."""
    sheets = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            size = np.array(box) - gap_m
            size[axis] = 0.0
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2.0
            vertices = np.zeros((4, 3))
            vertices[:, [i for i in range(3) if i != axis]] = corners
            vertices = vertices * size
            vertices[:, axis] = side * box[axis]
            sheets.append(trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False))
    seat = trimesh.Trimesh([[0, -0.5, -0.4], [0, 0.5, -0.4], [0, 0.5, 0.3]], [[0, 1, 2]], process=False)
    return trimesh.util.concatenate([*sheets, seat])


def test_sheets_with_gaps_around_a_seat_are_wrapped_where_they_stand() -> None:
    mesh, report = close_mesh(panels(0.03), "panels")
    assert report.wrapped
    assert report.seal_m == 0.05
    assert report.departure_m < 0.005
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.prod(SIZE), rel=0.01)
    points = generator("panels").uniform(-1, 1, (3000, 3)) * [2.3, 1.2, 1.0]
    q = np.abs(points) - np.array(SIZE) / 2.0
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    off = np.abs(signed_distance(mesh, points) - exact)
    assert np.quantile(off, 0.9) < 0.01
    assert off.max() < 0.04
    assert len(sample_sdf(mesh, 100, generator("samples")).points) == 100


def test_wider_gaps_take_a_wider_seal() -> None:
    _, report = close_mesh(panels(0.20, (2.0, 1.2, 1.0)), "panels")
    assert report.seal_m == 0.20
    assert "gaps up to 20 cm bridged" in str(report)


def test_overlapping_solids_become_their_union() -> None:
    cabin = body((1.0, 0.8, 0.6), (0, 0, 0.4))
    both = trimesh.util.concatenate([body(SMALL), cabin])
    assert correctly_oriented_share(both) < 0.99
    mesh, report = close_mesh(both, "both")
    assert report.watertight
    assert report.wrapped
    assert mesh.volume == pytest.approx(np.prod(SMALL) + 1.0 * 0.8 * 0.3, rel=0.01)
    assert correctly_oriented_share(mesh) > 0.999


@pytest.mark.parametrize(
    "mesh",
    [
        without_faces(body(SMALL).subdivide(), facing(body(SMALL).subdivide(), (1, 0, 0))),
        trimesh.Trimesh([[0, 0, 0], [2, 0, 0.5], [2, 1, 0], [0, 1, 0.5]], [[0, 1, 2], [0, 2, 3]], process=False),
    ],
    ids=["box without its nose", "bent sheet"],
)
def test_what_encloses_nothing_is_refused(mesh: trimesh.Trimesh) -> None:
    with pytest.raises(InputError, match=r"car\.obj: the mesh encloses no solid") as caught:
        close_mesh(mesh, "car.obj")
    assert caught.value.remedy


def test_closed_solid_that_fills_little_of_its_box_is_a_vehicle() -> None:
    mesh, report = close_mesh(
        trimesh.util.concatenate([body((4.0, 1.8, 0.4)), body((1.0, 0.1, 1.0), (0, 0, 0.8))]), "bed"
    )
    assert not report.wrapped
    assert mesh.volume == pytest.approx(4.0 * 1.8 * 0.4 + 0.1)


def test_thin_frame_is_no_vehicle() -> None:
    bars = [body((4.0, 0.1, 0.1), (0, y, z)) for y in (-0.9, 0.9) for z in (0.0, 1.3)]
    with pytest.raises(InputError, match=r"frame\.stl"):
        close_mesh(trimesh.util.concatenate(bars), "frame.stl")


def test_repair_does_not_change_the_mesh_it_is_given() -> None:
    inverted = wedge()
    inverted.invert()
    faces = np.array(inverted.faces)
    close_mesh(inverted, "inverted")
    assert np.array_equal(inverted.faces, faces)


def test_published_cars_are_closed(real_data: Callable[[str], Path]) -> None:
    files = find_meshes(real_data("vehicles"))
    assert len(files) == 57
    frame = MeshFrame(length_m=4.5)
    vehicle = read_mesh_vehicle(files[0], frame)
    assert str(vehicle.repair) == "closed; nothing to repair"
    assert vehicle.size_m[0] == pytest.approx(4.5)
    # One mesh has collapsed faces, and edges of four faces: closed all the same.
    wagon = read_mesh_vehicle(next(file for file in files if file.name.startswith("wagon_292")), frame)
    assert wagon.repair.dropped_faces == 4
    assert not wagon.repair.wrapped


def test_real_cad_with_open_wheel_arches_is_wrapped_within_a_centimetre(real_data: Callable[[str], Path]) -> None:
    data = json.loads((real_data("cad") / "mazida-6-2015.json").read_text())
    faces = np.array(data["faces"]) - 1
    mesh = trimesh.Trimesh(np.array(data["vertices"], np.float64), faces, process=False)
    car, report = close_mesh(MeshFrame("+z", "-y", "m").to_object(mesh, "cad"), "cad")
    assert report.wrapped
    assert report.seal_m == 0.40
    assert report.departure_m < 0.01
    assert car.is_watertight
    assert 0.35 < car.volume / np.prod(np.ptp(car.vertices, axis=0)) < 0.7
