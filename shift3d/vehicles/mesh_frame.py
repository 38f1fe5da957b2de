"""Transform from a mesh file's axes and unit to the object frame: x forward, y left, z up, metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError

if TYPE_CHECKING:
    import trimesh

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
LENGTH_M = (2.0, 20.0)
"""Length range of road vehicles, from microcar to lorry. A length outside it means a wrong unit or orientation."""
WIDEST_M = 6.0
"""Largest width and height, with mirrors, load and some margin. A cube of 20 m would exhaust the memory of the repair,
which uses a grid of 2.5 cm."""


@dataclass(frozen=True)
class MeshFrame:
    """Orientation and unit of a mesh file.

    forward, up: axes of the file, as in "-z". The default is that of ShapeNet versions 1 and 2: up +y, front -z. glTF's
    own convention is up +y, forward +z.
    unit: of the file, a key of UNITS_M. length_m: vehicle length from nose to tail in metres; replaces the unit for
    normalised meshes.
    """

    forward: str = "-z"
    up: str = "+y"
    unit: str | None = None
    length_m: float | None = None

    def __post_init__(self) -> None:
        for key, axis in (("forward", self.forward), ("up", self.up)):
            if axis not in AXES:
                raise InputError(
                    f"{key}={axis} is not an axis", where="orientation", remedy=f"One of: {', '.join(AXES)}"
                )
        if self.forward[1] == self.up[1]:
            what = f"forward={self.forward} and up={self.up} lie on one axis"
            raise InputError(what, where="orientation", remedy="Give two different axes of the file")
        if (self.unit is None) == (self.length_m is None):
            given = "no scale is given" if self.unit is None else "unit and length_m are both given"
            raise InputError(given, where="scale", remedy="Give one of unit=m (or cm, mm, in) and length_m=4.5")
        if self.unit is not None and self.unit not in UNITS_M:
            raise InputError(f"unknown unit {self.unit!r}", where="scale", remedy=f"One of: {', '.join(UNITS_M)}")
        if self.length_m is not None and not LENGTH_M[0] <= self.length_m <= LENGTH_M[1]:
            remedy = f"Give one between {LENGTH_M[0]:g} and {LENGTH_M[1]:g} metres"
            raise InputError(f"length_m={self.length_m:g} is no vehicle's", where="scale", remedy=remedy)

    def object_R_file(self) -> NDArray[np.float64]:
        """Return the (3, 3) rotation whose rows are forward, left and up in the file's axes; always right-handed."""
        forward, up = _axis(self.forward), _axis(self.up)
        return np.stack([forward, np.cross(up, forward), up])

    def to_object(self, mesh: trimesh.Trimesh, where: str) -> trimesh.Trimesh:
        """Return a copy of a mesh in the object frame, metres, with the box's centre at the origin.

        Raises: InputError naming `where` (the file) when the mesh is flat, is not longest along forward, or has no
        plausible vehicle size; the remedy names a unit that would give a plausible length.
        """
        vertices = np.asarray(mesh.vertices, np.float64) @ self.object_R_file().T
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        extent = high - low
        if extent.min() < 1e-3 * extent.max() or extent.max() <= 0.0:
            raise InputError("the mesh is flat", where=where, remedy="Give a vehicle, with length, width and height")
        self.check_direction(extent, where)
        scale = self.length_m / extent[0] if self.length_m is not None else UNITS_M[self.unit or "m"]
        if self.length_m is None:
            _check_length(float(extent[0]), float(scale), where)
        if extent[1:].max() * scale > WIDEST_M:
            what = f"the vehicle would be {extent[1] * scale:g} m wide and {extent[2] * scale:g} m high"
            raise InputError(what, where=where, remedy=f"Give a mesh of one vehicle: at most {WIDEST_M:g} m of either")
        import trimesh

        return trimesh.Trimesh((vertices - (low + high) / 2.0) * scale, mesh.faces, process=False)

    def check_direction(self, extent: NDArray[np.float64], where: str, prefix: str = "") -> None:
        """Raise InputError at `where` unless extent (3,), object frame, is largest along x. prefix: of settings."""
        longest = int(np.argmax(extent))
        if longest != 0:
            axis = "xyz"[int(np.argmax(np.abs(self.object_R_file()[longest])))]
            what = f"longest along {axis}, not along {prefix}forward={self.forward}"
            raise InputError(what, where=where, remedy=f"Give {prefix}forward=+{axis} or -{axis}, and {prefix}up=")


def _axis(name: str) -> NDArray[np.float64]:
    unit = np.zeros(3)
    unit["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return unit


def _check_length(length: float, scale: float, where: str) -> None:
    if LENGTH_M[0] <= length * scale <= LENGTH_M[1]:
        return
    fitting = [unit for unit, metres in UNITS_M.items() if LENGTH_M[0] <= length * metres <= LENGTH_M[1]]
    remedy = f"Give unit={fitting[0]}" if fitting else "Give length_m=, how long the vehicle is in metres"
    raise InputError(f"the vehicle would be {length * scale:g} m long", where=where, remedy=remedy)
