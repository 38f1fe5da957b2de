"""Reference sets of shapes made of boxes, whose surface distances are known."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from shift3d.naturalness.build import build_reference
from shift3d.naturalness.measure import NaturalnessMeter
from shift3d.naturalness.reference import ReferenceSet
from shift3d.naturalness.sources import Build

Vector = tuple[float, float, float]


def box(length: float = 4.5, width: float = 1.8, height: float = 1.5) -> trimesh.Trimesh:
    return trimesh.creation.box((length, width, height))


def on_legs(clearance_m: float = 0.2, length_m: float = 4.5) -> trimesh.Trimesh:
    """Return a body 1.8 m wide and 1.3 m high over four legs that stand outside the middle."""
    return trimesh.util.concatenate(
        [trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre)) for centre, size in
         legged_boxes(clearance_m, length_m)]
    )  # fmt: skip


def legged_boxes(clearance_m: float = 0.2, length_m: float = 4.5) -> list[tuple[Vector, Vector]]:
    """Return centre and size of its boxes, metres, the ground at z = 0."""
    body: tuple[Vector, Vector] = (0.0, 0.0, 0.65 + clearance_m / 2), (length_m, 1.8, 1.3 - clearance_m)
    return [body, *(((x, y, 0.3), (0.5, 0.2, 0.6)) for x in (-1.5, 1.5) for y in (-0.75, 0.75))]


@dataclass(frozen=True)
class Meshes:
    """Source of these meshes."""

    meshes: tuple[trimesh.Trimesh, ...]

    def identity(self) -> dict[str, Any]:
        return {"kind": "given", "bounds": [mesh.bounds.tolist() for mesh in self.meshes]}

    def members(self) -> Sequence[Build]:
        def build(number: int) -> tuple[str, trimesh.Trimesh]:
            return f"member-{number}", self.meshes[number]

        return [functools.partial(build, number) for number in range(len(self.meshes))]


def legged(lengths: Iterable[float]) -> Meshes:
    """Return bodies on legs of these lengths, otherwise alike."""
    return Meshes(tuple(on_legs(length_m=float(length)) for length in lengths))


def reference(source: Meshes) -> ReferenceSet:
    members, calibration = build_reference(source, "given")
    numbered = [member.surface() for member in members]
    prints = np.stack([member.fingerprint for member in members])
    return ReferenceSet([member.name for member in members], prints, numbered.__getitem__, calibration)


def measures(source: Meshes) -> NaturalnessMeter:
    return NaturalnessMeter(reference(source))
