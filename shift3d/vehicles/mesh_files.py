"""Readers of vehicle meshes: one PLY, OBJ, GLB or STL file, a folder of them, or a folder in ShapeNet's layout."""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh

from shift3d.errors import InputError
from shift3d.vehicles.family.spec import BODY_TYPES, MORE_BODY_TYPES
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.repair import RepairReport, close_mesh

SUFFIXES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
SHAPENET_FILE = Path("models") / "model_normalized.obj"


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and the name of its vehicle."""

    name: str
    path: Path

    def sha256(self) -> str:
        """Compute the file's SHA-256, hex, for a .gltf with its vertex files. Raises: InputError if unreadable."""
        digest = hashlib.sha256(content := _content(self.path))
        for part in _files_beside(content) if self.path.suffix.lower() == ".gltf" else ():
            if (file := self.path.parent / part).is_file():  # `read_mesh` reports missing files
                digest.update(_content(file))
        return digest.hexdigest()


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy="Give a mesh") from error


def _files_beside(gltf: bytes) -> list[str]:
    """Return the files named by a .gltf's buffers; none for an unreadable .gltf, which `read_mesh` reports."""
    try:
        buffers = json.loads(gltf)["buffers"]
        uris = [str(buffer["uri"]) for buffer in buffers if "uri" in buffer]
    except (ValueError, KeyError, TypeError):
        return []
    return [unquote(uri) for uri in uris if not uri.startswith("data:")]


def find_meshes(path: Path | str) -> list[MeshFile]:
    """Find the meshes at a path, sorted by name.

    In ShapeNet's layout, {synset}/{id}/models/model_normalized.obj at any depth below `path`, a vehicle's name is its
    id, and other files are ignored. Otherwise every mesh below `path` counts; its name is its relative path without
    suffix. Linked folders are followed; a folder with several links counts once.
    Raises: InputError when the path does not exist, it holds no mesh, or two of its meshes have one name.
    """
    root = Path(path).expanduser()
    if root.is_file():
        if root.suffix.lower() not in SUFFIXES:
            raise InputError("not a mesh file", where=str(root), remedy=f"Give one of {', '.join(SUFFIXES)}")
        return [MeshFile(_slug(root.stem), root)]
    if not root.is_dir():
        raise InputError("no such file or folder", where=str(root), remedy="Give a mesh or a folder of meshes")
    below = list(_files_below(root))
    models = [file for file in below if file.parts[-2:] == SHAPENET_FILE.parts]
    found = [MeshFile(_slug(file.absolute().parents[1].name), file) for file in models]
    if not found:
        files = [file for file in below if file.suffix.lower() in SUFFIXES]
        found = [MeshFile(_slug(file.relative_to(root).with_suffix("").as_posix()), file) for file in files]
    if not found:
        raise InputError(
            "no meshes below this folder", where=str(root), remedy=f"Give a folder with files {', '.join(SUFFIXES)}"
        )
    found.sort(key=lambda mesh: (mesh.name, mesh.path))
    for first, second in itertools.pairwise(found):
        if first.name == second.name:
            raise InputError(f"two meshes are named {first.name}", where=str(second.path), remedy="Rename one")
    return found


def _files_below(root: Path) -> Iterator[Path]:
    """Yield every file below a folder. Links are followed last, so that a file gets the name of its real path. Each
    folder is visited once, also with circular links."""
    seen, waiting = set(), deque([root])
    while waiting:
        folder = waiting.popleft()
        if (real := folder.resolve()) in seen:
            continue
        seen.add(real)
        inside: list[Path] = []
        with contextlib.suppress(PermissionError):  # e.g. lost+found of a disk
            inside = sorted(folder.iterdir())
        yield from (entry for entry in inside if entry.is_file())
        folders = [entry for entry in inside if entry.is_dir()]
        waiting.extendleft(entry for entry in folders if not entry.is_symlink())
        waiting.extend(entry for entry in folders if entry.is_symlink())


def _slug(name: str) -> str:
    """Replace all characters that are special in file names or Hydra overrides."""
    kept = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_") else "_" for letter in name)
    return f"_{kept}" if kept.lower() in ("null", "true", "false", "nan", "inf") else kept


def read_mesh(path: Path | str) -> trimesh.Trimesh:
    """Read the triangles of a file, in the file's axes and unit: all parts of a scene, with their node transforms.

    Textures and materials are not read. Coincident vertices are not merged, see `repair`.
    Raises: InputError naming the file when it cannot be read, has no faces, or has coordinates that are not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="Give a mesh")
    suffix = path.suffix.lower()
    options: dict[str, Any] = {"skip_materials": True} if suffix in (".obj", ".glb", ".gltf") else {}
    try:
        # Read from memory: for a file on disk a reader allocates as many bytes as the header claims before it reads
        # them. A .gltf refers to other files, so it needs its path.
        source: Any = path if suffix == ".gltf" else io.BytesIO(path.read_bytes())
        scene = trimesh.load_scene(source, file_type=suffix[1:], process=False, **options)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    except Exception as error:  # each format's reader raises errors of other types for a broken file
        what = f"not a readable {suffix[1:].upper()} file ({type(error).__name__}: {str(error)[:200]})"
        raise InputError(what, where=str(path), remedy="Export it again") from error
    vertices = [np.asarray(part.vertices, np.float64) for part in parts]
    if any(part.shape[1:] != (3,) for part in vertices):
        # A line with a missing number can make a reader take all lines for pairs.
        raise InputError("vertices are not x, y, z", where=str(path), remedy="Export it again")
    starts = np.cumsum([0, *(len(part) for part in vertices)])
    faces = [np.asarray(part.faces, np.int64) + start for part, start in zip(parts, starts, strict=False)]
    if not sum(len(part) for part in faces):
        raise InputError("the mesh has no faces", where=str(path), remedy="Export triangles, not a point cloud")
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise InputError("a face names a vertex that is not there", where=str(path), remedy="Export it again")
    if not np.isfinite(mesh.vertices[np.unique(mesh.faces)]).all():
        raise InputError("coordinates that are not finite", where=str(path), remedy="Export it again")
    mesh.remove_unreferenced_vertices()
    return mesh


UNKNOWN_BODY_TYPE = "vehicle"


@dataclass(frozen=True)
class MeshVehicle:
    """A vehicle's closed mesh in the object frame, metres, with its source file and repair report."""

    name: str
    file: MeshFile
    mesh: trimesh.Trimesh
    repair: RepairReport

    @property
    def body_type(self) -> str:
        """Body type that the name begins with, or UNKNOWN_BODY_TYPE."""
        known = (body_type for body_type in BODY_TYPES + MORE_BODY_TYPES if self.name.startswith(body_type))
        return next(known, UNKNOWN_BODY_TYPE)

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height of the mesh's box, metres."""
        extent = np.ptp(np.asarray(self.mesh.vertices), axis=0)
        return (float(extent[0]), float(extent[1]), float(extent[2]))

    def facts(self) -> dict[str, Any]:
        """Return the description as plain values for a JSON file."""
        return {
            "name": self.name,
            "file": str(self.file.path),
            "body_type": self.body_type,
            "size_m": list(self.size_m),
            "repair": asdict(self.repair),
            "repair_text": str(self.repair),
        }


def read_mesh_vehicle(file: MeshFile, frame: MeshFrame) -> MeshVehicle:
    """Read and repair the mesh of one file.

    Raises: InputError naming the file: unreadable, no faces, wrong unit or orientation, or impossible to repair.
    """
    where = str(file.path)
    mesh, report = close_mesh(frame.to_object(read_mesh(file.path), where), where)
    centred = trimesh.Trimesh(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces, process=False)
    return MeshVehicle(file.name, file, centred, report)
