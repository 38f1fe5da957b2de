"""Sources of a reference set's members: the wide family, mesh files, or the codes of a vehicle set."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from shift3d.errors import InputError

# Modules that build members are imported late: a plan needs only a source's identity.
if TYPE_CHECKING:
    import trimesh

    from shift3d.vehicles.mesh_files import MeshFile
    from shift3d.vehicles.mesh_frame import MeshFrame

Build = Callable[[], "tuple[str, trimesh.Trimesh]"]
VERSION = 1  # version of the member definition; raised when the same settings give other members


class ReferenceSource(Protocol):
    """Interface of a source of reference members."""

    def identity(self) -> dict[str, Any]:
        """Return plain values that determine the set, including hashes of files. Builds nothing."""
        ...

    def members(self) -> Sequence[Build]:
        """Return a picklable function per member: name, mesh (metres, x forward, z up). Raises: InputError if empty."""
        ...


@dataclass(frozen=True)
class WideReference:
    """Reference source of the wide family, both sides of the split: every fourth member is held out."""

    members_count: int = 2000
    seed: int = 11
    resolution_m: float = 0.06

    def identity(self) -> dict[str, Any]:
        return {"kind": "wide", "members": self.members_count, "seed": self.seed, "resolution_m": self.resolution_m}

    def members(self) -> Sequence[Build]:
        return [
            functools.partial(_wide_member, index, self.seed, self.resolution_m) for index in range(self.members_count)
        ]


def _wide_member(index: int, seed: int, resolution_m: float) -> tuple[str, trimesh.Trimesh]:
    import numpy as np
    import trimesh
    from skimage.measure import marching_cubes

    from shift3d.vehicles.family.solid import LEVELS_M
    from shift3d.vehicles.family.wide import wide_field, wide_vehicle

    held_out = index % 4 == 3
    number = index // 4 if held_out else index - (index + 1) // 4
    spec = wide_vehicle(number, seed, "held_out" if held_out else "seen")
    # As `build_wide_mesh`, but without the steps that give one closed piece, which take half of the time.
    vertices, faces, _, _ = marching_cubes(wide_field(spec, resolution_m), LEVELS_M[0], spacing=(resolution_m,) * 3)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    sized = (vertices - low) * (np.array(spec.size_m) / (high - low))
    return f"{spec.kind}-{number:05d}", trimesh.Trimesh(sized, faces, process=False)


@dataclass(frozen=True)
class MeshReference:
    """Reference source of all meshes of a folder, unrepaired: holes stay, interior surfaces count. frame: of the files.

    Of files with equal bytes only the first by name is a member: a duplicate would be 0 cm from another member.
    """

    folder: str
    frame: MeshFrame

    def identity(self) -> dict[str, Any]:
        files = [[file.name, digest] for digest, file in self._files().items()]
        return {"kind": "meshes", "frame": vars(self.frame), "files": files}

    def members(self) -> Sequence[Build]:
        return [functools.partial(_read, file.name, file.path, self.frame) for file in self._files().values()]

    def _files(self) -> dict[str, MeshFile]:
        """Return the first file of each content, by its hash."""
        from shift3d.vehicles.mesh_files import find_meshes

        found: dict[str, MeshFile] = {}
        for file in find_meshes(self.folder):
            found.setdefault(file.sha256(), file)
        return found


def _read(name: str, path: Path, frame: MeshFrame) -> tuple[str, trimesh.Trimesh]:
    from shift3d.vehicles.mesh_files import read_mesh

    return name, frame.to_object(read_mesh(path), str(path))


@dataclass(frozen=True)
class SetReference:
    """Reference source of all codes that a vehicle set's decoder was trained on; None and "wide": the shipped sets."""

    folder: str | None = None

    def _files(self) -> tuple[Path, Path]:
        from shift3d.vehicles.sources import vehicle_set_folder
        from shift3d.vehicles.vehicle_set import DECODER_FILE, VEHICLES_FILE

        folder = vehicle_set_folder(self.folder, "naturalness.folder")
        for name in (VEHICLES_FILE, DECODER_FILE):
            if not (folder / name).is_file():
                raise InputError(f"holds no {name}", where=str(folder), remedy="Give a folder that training wrote")
        return folder / VEHICLES_FILE, folder / DECODER_FILE

    def identity(self) -> dict[str, Any]:
        return {"kind": "set", "files": [hashlib.sha256(file.read_bytes()).hexdigest() for file in self._files()]}

    def members(self) -> Sequence[Build]:
        from shift3d.vehicles.vehicle import family_vehicles

        vehicles, decoder = self._files()
        return [
            functools.partial(_decoded, str(vehicles), str(decoder), index)
            for index in range(len(family_vehicles(vehicles)))
        ]


def _decoded(vehicles: str, decoder: str, index: int) -> tuple[str, trimesh.Trimesh]:
    from shift3d.naturalness.decoded import decoded_mesh

    vehicle, network = _set_of(vehicles, decoder)
    return vehicle[index].name, decoded_mesh(vehicle[index], network, vehicle[index].latent_code)


@functools.lru_cache(maxsize=1)
def _set_of(vehicles: str, decoder: str) -> tuple[Any, Any]:
    from shift3d.sdf.decoder import load_decoder
    from shift3d.vehicles.vehicle import family_vehicles

    return family_vehicles(vehicles), load_decoder(decoder)


def reference_source(values: Mapping[str, Any]) -> ReferenceSource:
    """Build the source from plain settings: kind wide, meshes or set, and its options (`conf/naturalness`).

    Raises: InputError for invalid axes or scale.
    """
    values = dict(values)
    kind = values.pop("kind")
    if kind == "wide":
        return WideReference(values["members"])
    if kind == "set":
        return SetReference(values["folder"])
    from shift3d.vehicles.mesh_frame import MeshFrame

    return MeshReference(values.pop("folder"), MeshFrame(**values))


def source_hash(source: ReferenceSource) -> str:
    """Compute the 128-bit BLAKE2b, hex, of a reference source's identity."""
    text = json.dumps([VERSION, source.identity()], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
