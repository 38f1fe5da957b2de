"""A vehicle read from a mesh file: oriented, scaled, closed, and with a record of how."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from shift3d.vehicles.family.spec import BODY_TYPES, MORE_BODY_TYPES
from shift3d.vehicles.mesh_files import MeshFile, read_mesh
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.repair import RepairReport, repaired

UNKNOWN_BODY_TYPE = "vehicle"


@dataclass(frozen=True)
class MeshVehicle:
    """A vehicle's closed mesh in the object frame, metres, and where it comes from.

    seconds: wall time of reading and repairing.
    """

    name: str
    file: MeshFile
    mesh: trimesh.Trimesh
    repair: RepairReport
    seconds: float

    @property
    def body_type(self) -> str:
        """The body type that the name begins with, or UNKNOWN_BODY_TYPE."""
        known = (body_type for body_type in BODY_TYPES + MORE_BODY_TYPES if self.name.startswith(body_type))
        return next(known, UNKNOWN_BODY_TYPE)

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height of the mesh's box."""
        extent = np.ptp(np.asarray(self.mesh.vertices), axis=0)
        return (float(extent[0]), float(extent[1]), float(extent[2]))

    def facts(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "name": self.name,
            "file": str(self.file.path),
            "body_type": self.body_type,
            "size_m": list(self.size_m),
            "repair": self.repair.facts(),
            "repair_text": str(self.repair),
            "seconds": round(self.seconds, 3),
        }


def read_mesh_vehicle(file: MeshFile, frame: MeshFrame) -> MeshVehicle:
    """Read one file.

    Raises: InputError naming the file: unreadable, no faces, the wrong unit or orientation, or not to be repaired.
    """
    start = time.monotonic()
    where = str(file.path)
    mesh, report = repaired(frame.to_object(read_mesh(file.path), where), where)
    centred = trimesh.Trimesh(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces, process=False)
    return MeshVehicle(file.name, file, centred, report, time.monotonic() - start)
