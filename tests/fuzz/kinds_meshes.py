"""Mutants of vehicle meshes in PLY (text and binary), OBJ, STL and GLB: read, oriented, scaled; some also closed."""

from __future__ import annotations

import dataclasses
import functools
import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from feeding import InputKind, register
from mutations import Rng, mutate_bytes, mutate_text, pick
from value_mutations import mutate_values, write_specials

from shift3d.sdf.samples import is_closed
from shift3d.vehicles.mesh_files import MeshFile, find_meshes, read_mesh, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import LENGTH_M, WIDEST_M, MeshFrame

FRAME = MeshFrame("+x", "+z", "m")
FORMATS = ("text.ply", "binary.ply", "car.obj", "car.stl", "car.glb")


@functools.cache
def car() -> trimesh.Trimesh:
    """Return a closed solid of 44 triangles, 2.4 m long: a wedge and a cabin that reaches into it."""
    outline = np.array([[-1.2, 0.2], [1.2, 0.2], [1.2, 0.5], [-1.2, 0.9]])
    sides = [np.column_stack([outline[:, 0], np.full(4, y), outline[:, 1]]) for y in (-0.6, 0.6)]
    parts = [trimesh.convex.convex_hull(np.concatenate(sides))]
    parts += [
        trimesh.creation.box((0.3, 0.2, 0.3), transform=_shift(x, y, 0.0)) for x in (-0.9, 0.9) for y in (-0.4, 0.4)
    ]
    return trimesh.util.concatenate(parts)


def _shift(x: float, y: float, z: float) -> Any:
    return trimesh.transformations.translation_matrix([x, y, z])


@functools.cache
def _content(name: str) -> bytes:
    options: dict[str, Any] = {"encoding": "ascii"} if name == "text.ply" else {}
    exported = car().export(file_type=name.rpartition(".")[2], **options)
    return exported.encode() if isinstance(exported, str) else bytes(exported)


def write_mesh(folder: Path, name: str) -> None:
    (folder / name).write_bytes(_content(name))


def load_mesh(folder: Path) -> Any:
    """Read a mesh and turn it into the object frame. Returns its identity."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the readers' own warnings, before any check
        (file,) = find_meshes(folder)
        mesh = read_mesh(file.path)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    assert vertices.dtype == np.float64 and vertices.shape[1:] == (3,) and np.isfinite(vertices).all()
    assert faces.shape[1:] == (3,) and len(faces) and faces.min() >= 0 and faces.max() < len(vertices)
    vehicle = FRAME.to_object(mesh, str(file.path))
    placed = np.asarray(vehicle.vertices)
    extent = np.ptp(placed, axis=0)
    assert np.isfinite(extent).all() and LENGTH_M[0] <= extent[0] <= LENGTH_M[1] and extent[1:].max() <= WIDEST_M
    assert np.allclose(np.asarray(vehicle.bounds).sum(axis=0), 0.0, atol=1e-6)
    a, b, c = (placed[corner] for corner in np.asarray(vehicle.faces).T)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0
    return [round(float(x), 4) for x in (*extent, area)]


def load_vehicle(folder: Path) -> Any:
    """Read a mesh and close it, too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        (file,) = find_meshes(folder)
        vehicle = read_mesh_vehicle(MeshFile("car", file.path), FRAME)
    assert np.isfinite(vehicle.mesh.vertices).all() and is_closed(vehicle.mesh)
    assert vehicle.mesh.volume > 0.0 and min(vehicle.size_m) > 0.0
    facts = json.loads(json.dumps(dataclasses.asdict(vehicle.repair), allow_nan=False))
    assert facts["departure_m"] >= 0.0
    return [round(size, 3) for size in vehicle.size_m]


def _mutated_glb(content: bytes, rng: Rng) -> bytes:
    """Change the JSON chunk inside and correct the lengths."""
    length = struct.unpack("<I", content[12:16])[0]
    text = json.dumps(mutate_values(json.loads(content[20 : 20 + length]), rng)).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + content[20 + length :]
    return content[:8] + struct.pack("<I", 12 + len(body)) + body


def _mutated_solid(name: str, rng: Rng) -> bytes:
    """Export a damaged mesh with the library: special coordinates, missing, repeated, turned or wrong faces."""
    vertices, faces = np.array(car().vertices), np.array(car().faces)
    how = pick(("vertices", "drop", "turn", "double", "scale", "degenerate", "flat", "empty", "far"), rng)
    if how == "vertices":
        vertices = write_specials(vertices, rng)
    elif how in ("drop", "turn", "double"):
        some = rng.integers(len(faces), size=int(rng.integers(1, 8)))
        if how == "turn":
            faces[some] = faces[some][:, ::-1]
        faces = {"drop": np.delete(faces, some, 0), "double": np.concatenate([faces, faces[some]])}.get(str(how), faces)
    elif how == "scale":
        vertices = vertices * float(pick((1000.0, 0.01, 1e30, 1e-30, -1.0), rng))
    elif how == "flat":
        vertices[:, int(rng.integers(3))] = 0.0
    elif how == "far":
        vertices = vertices + 1e6
    else:
        faces[int(rng.integers(len(faces)))] = 0
        faces = faces[:0] if how == "empty" else faces
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    options: dict[str, Any] = {"encoding": "ascii"} if name == "text.ply" else {}
    exported = mesh.export(file_type=name.rpartition(".")[2], **options)
    return exported.encode() if isinstance(exported, str) else bytes(exported)


def _harmless(name: str, content: bytes) -> bytes:
    if name.endswith(".obj"):
        return b"# a comment\n\n" + content.replace(b"\n", b"\r\n")
    if name.endswith(".ply"):
        return content.replace(b"\nelement vertex", b"\ncomment by hand\nelement vertex", 1)
    return content


def mesh_mutator(name: str) -> Callable[[Path, Rng], str]:
    textual = name in ("text.ply", "car.obj")

    def mutate(folder: Path, rng: Rng) -> str:
        path = folder / name
        content = path.read_bytes()
        how = pick(("file", "file", "solid", "harmless", "structure"), rng)
        if how == "harmless":
            if rng.uniform() < 0.4:
                path.write_bytes(_harmless(name, content))
                return "harmless"
            how = "file"
        if how == "solid":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    path.write_bytes(_mutated_solid(name, rng))
                    return "solid"
                except Exception:  # the writer refuses what its format cannot hold
                    how = "file"
        if how == "structure" and name == "car.glb":
            path.write_bytes(_mutated_glb(content, rng))
        else:
            path.write_bytes((mutate_text if textual else mutate_bytes)(content, rng))
        return str(how)

    return mutate


def mutate_any(folder: Path, rng: Rng) -> str:
    """Change the binary PLY in ways that a reader accepts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (folder / "binary.ply").write_bytes(_mutated_solid("binary.ply", rng))
    return "solid"


for name in FORMATS:
    write = functools.partial(write_mesh, name=name)
    register(InputKind(f"mesh, {name}", 150, write, mesh_mutator(name), load_mesh))
register(InputKind("mesh, closed", 30, functools.partial(write_mesh, name="binary.ply"), mutate_any, load_vehicle))
