"""Hard cases of vehicles: meshes, and the files of vehicle sets."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from catalogue import hard_case
from clear_errors import place, refused
from safetensors.numpy import load_file, save_file
from valid_weights import NETWORKS, VEHICLES, write_experiment, write_vehicles

from shift3d.sdf.samples import signed_distance
from shift3d.vehicles.deepsdf_vehicles import DeepSdfVehicles
from shift3d.vehicles.mesh_files import read_mesh
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.repair import close_mesh
from shift3d.vehicles.vehicle import Vehicle, baseline_vehicles

AREA = "vehicle files"
IN_METRES = MeshFrame("+x", "+z", "m")


def block(length: float = 2.4, width: float = 1.2, height: float = 1.0) -> trimesh.Trimesh:
    return trimesh.creation.box((length, width, height))


def read(content: bytes | str, name: str = "car.ply") -> trimesh.Trimesh:
    with place() as folder:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_mesh(folder / name)


def with_facts(change: Callable[[dict[str, Any], dict[str, np.ndarray]], object]) -> dict[str, Vehicle]:
    """Return the vehicles of a small set after a change of one vehicle's facts or of the tensors."""
    with place() as folder:
        write_vehicles(folder)
        from safetensors import safe_open

        with safe_open(str(folder / VEHICLES), framework="np") as file:
            metadata = dict(file.metadata())
        tensors, baselines = load_file(folder / VEHICLES), json.loads(metadata["baselines"])
        change(baselines["suv"], tensors)
        save_file(tensors, folder / VEHICLES, metadata={**metadata, "baselines": json.dumps(baselines)})
        return baseline_vehicles(folder / VEHICLES)


@hard_case(
    area=AREA,
    why="a point cloud is a mesh file without faces",
    must="an error that names the file",
    guard="faces are counted before the parts are put together",
)
def a_mesh_without_faces() -> None:
    refused(lambda: read("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "car.obj"), "car.obj", "no faces")
    refused(lambda: read(trimesh.PointCloud(np.eye(3)).export(file_type="ply")), "car.ply", "no faces")


@hard_case(
    area=AREA,
    why="NaN is neither the largest nor the smallest coordinate, so that a box around it looks finite",
    must="an error that names the file",
    guard="every vertex that a face names must be finite",
)
def a_mesh_with_a_vertex_of_nan() -> None:
    broken = block()
    vertices = np.array(broken.vertices)
    vertices[3, 1] = np.nan
    content = trimesh.Trimesh(vertices, broken.faces, process=False).export(file_type="ply")
    refused(lambda: read(content), "car.ply", "not finite")


@hard_case(
    area=AREA,
    why="a face that names a vertex beyond the last reads memory that is none of it",
    must="an error that names the file",
    guard="the largest index is compared with the number of vertices",
)
def a_face_of_a_vertex_that_is_not_there() -> None:
    content = trimesh.Trimesh(np.eye(3), [[0, 1, 9]], process=False).export(file_type="ply")
    refused(lambda: read(content), "car.ply")


@hard_case(
    area=AREA,
    why="of an OBJ file that lacks one number of one vertex, the reader makes pairs of all of them",
    must="an error that names the file",
    guard="every vertex must have three coordinates",
)
def a_vertex_with_a_coordinate_missing() -> None:
    lines = block().export(file_type="obj").splitlines()
    last = max(index for index, line in enumerate(lines) if line.startswith("v "))
    lines[last] = lines[last].rpartition(" ")[0]
    refused(lambda: IN_METRES.to_object(read("\n".join(lines), "car.obj"), "car.obj"), "car.obj")


@hard_case(
    area=AREA,
    why="a header of a few bytes claims two gigabytes, which a reader asks for before it reads",
    must="an error that names the file, and no more memory than the file has",
    guard="the reader is given the bytes that there are",
)
def a_glb_with_an_absurd_length() -> None:
    content = struct.pack("<4sIIII", b"glTF", 2, 40, 2**31 - 1, 0x4E4F534A) + b"{}" * 10
    tracemalloc.start()
    try:
        refused(lambda: read(content, "car.glb"), "car.glb")
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


@hard_case(
    area=AREA,
    why="CAD is often in millimetres: a car of 4.5 km fits no scene, and one of 4.5 mm is between the beams",
    must="an error that says how long it would be, and the unit that would fit",
    guard="a vehicle is 2 to 20 m long",
)
def a_mesh_in_millimetres() -> None:
    mesh = block(4500.0, 1800.0, 1500.0)
    refused(lambda: IN_METRES.to_object(mesh, "car.stl"), "car.stl", "4500 m", "unit=mm")
    refused(lambda: IN_METRES.to_object(block(1e30, 1e29, 1e29), "car.stl"), "car.stl")


@hard_case(
    area=AREA,
    why="a house is no longer than a lorry; on the repair's grid of 2.5 cm it has half a billion nodes",
    must="an error that names the file, before anything is allocated",
    guard="a vehicle is at most 6 m wide and high",
)
def a_mesh_of_a_house() -> None:
    refused(lambda: IN_METRES.to_object(block(19.9, 19.8, 19.7), "house.ply"), "house.ply", "wide")


@hard_case(
    area=AREA,
    why="a sheet has an inside only by rounding",
    must="an error that names the file",
    guard="the shortest side of the box is at least a thousandth of the longest",
)
def a_flat_mesh() -> None:
    for thickness in (1e-6, 1e-3):
        refused(lambda t=thickness: IN_METRES.to_object(block(height=t), "sheet.ply"), "sheet.ply", "flat")


@hard_case(
    area=AREA,
    why="with its faces turned inwards, all of space but the vehicle is inside",
    must="negative distances inside and positive ones outside, with the faces turned and nothing else changed",
    guard="pieces with a negative volume are turned",
)
def a_mesh_that_is_inside_out() -> None:
    turned = block(2.0, 0.8, 0.6)
    turned.invert()
    mesh, report = close_mesh(turned, "car.ply")
    distance = signed_distance(mesh, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]))
    assert np.allclose(distance, [-0.3, 1.7]) and report.flipped_pieces == 1 and not report.wrapped


@hard_case(
    area=AREA,
    why="one missing triangle, and inside and outside are the same",
    must="the hole is closed, the rest of the surface stays where it is, and the report says so",
    guard="holes of three or four edges are filled before anything is wrapped",
)
def a_mesh_with_a_hole() -> None:
    whole = block(2.0, 0.8, 0.6)
    mesh, report = close_mesh(trimesh.Trimesh(whole.vertices, whole.faces[1:], process=False), "car.ply")
    assert report.filled_holes == 1 and report.widest_hole_m > 0.5 and not report.wrapped
    assert abs(mesh.volume - whole.volume) < 1e-9


@hard_case(
    area=AREA,
    why="two crossing sheets have length, width and height, and enclose nothing",
    must="an error that names the file",
    guard="what is wrapped must fill a share of its box",
)
def a_mesh_that_encloses_nothing() -> None:
    square = np.array([[-1.1, -0.4, 0.0], [1.1, -0.4, 0.0], [1.1, 0.4, 0.0], [-1.1, 0.4, 0.0]])
    upright = square[:, [0, 2, 1]] * (1.0, 1.0, 0.8)
    sheets = trimesh.Trimesh(np.concatenate([square, upright]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    refused(lambda: close_mesh(sheets, "sheets.ply"), "sheets.ply", "encloses no solid")


@hard_case(
    area=AREA,
    why="a matrix that stretches turns distances into other numbers: hits would lie off the surface",
    must="an error that names the file and the vehicle",
    guard="sdf_R_object must be orthonormal",
)
def a_vehicle_whose_transform_stretches() -> None:
    stretched = np.diag([1.0, 0.5, 1.0]).tolist()
    refused(lambda: with_facts(lambda facts, _: facts.update(sdf_R_object=stretched)), VEHICLES, "suv", "rotation")
    nan = (np.eye(3) * np.nan).tolist()
    refused(lambda: with_facts(lambda facts, _: facts.update(sdf_R_object=nan)), VEHICLES, "suv", "sdf_R_object")


@hard_case(
    area=AREA,
    why="a scale in centimetres, of zero or NaN: the decoder's sphere is a dot or a city",
    must="an error that names the file and the vehicle",
    guard="the vehicle's longest side must fit into the decoder's sphere",
)
def a_vehicle_of_another_scale_than_its_size() -> None:
    for scale in (250.0, 0.0, -2.5, 1e-300, float("nan")):
        refused(
            lambda scale=scale: with_facts(lambda facts, _: facts.update(scale_m=scale)), VEHICLES, "suv", "scale_m"
        )


@hard_case(
    area=AREA,
    why="a lorry in units of 60 m: a box checked every 45 cm in the decoder's sphere takes ten million evaluations",
    must="an error that names the file and the vehicle",
    guard="the scale is at most the length of the longest vehicle",
)
def a_vehicle_that_is_small_in_its_sphere() -> None:
    def lorry(scale_m: float) -> Callable[[dict[str, Any], object], None]:
        return lambda facts, _: facts.update(scale_m=scale_m, size_m=[18.0, 2.5, 3.2])

    refused(lambda: with_facts(lorry(60.0)), VEHICLES, "suv", "scale_m 60 is above 20")
    assert with_facts(lorry(20.0))["suv"].scale_m == 20.0


@hard_case(
    area=AREA,
    why="one NaN in a code makes every value of the field NaN, and NaN is no surface: the vehicle would vanish",
    must="an error that names the file and the tensor",
    guard="the tensor's values must all lie below a limit, which NaN does not",
)
def a_latent_code_with_nan() -> None:
    for value in (np.nan, np.inf, 1e30):

        def spoil(_: dict[str, Any], tensors: dict[str, np.ndarray], value: float = value) -> None:
            tensors["suv.latent_code"][100] = value

        refused(lambda spoil=spoil: with_facts(spoil), VEHICLES, "suv.latent_code")


@hard_case(
    area=AREA,
    why="codes of zeros cannot be scaled to any length",
    must="an error that names the folder and the setting",
    guard="the mean length of the codes is looked at before it divides",
)
def codes_that_were_never_trained() -> None:
    with place() as folder:
        write_experiment(folder, next(iter(NETWORKS)))
        _set_codes(folder, torch.zeros(3, 4))
        refused(lambda: DeepSdfVehicles(folder, code_norm=1.5).decoder(), folder.name, "code_norm")


def _set_codes(folder: Path, codes: torch.Tensor) -> None:
    torch.save({"epoch": 3, "latent_codes": {"weight": codes}}, folder / "LatentCodes" / "latest.pth")
