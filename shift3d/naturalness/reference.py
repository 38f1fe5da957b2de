"""Reference set: surfaces of its members in one file, and the search for the member nearest to a shape."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.naturalness.calibration import Calibration
from shift3d.naturalness.surface import POINTS, Surface
from shift3d.store.arrays import write_safetensors

if TYPE_CHECKING:
    from collections.abc import Callable

_SPACING_M, _REACH_M = 0.25, 0.5
PROBES: NDArray[np.float64] = np.stack(
    np.meshgrid(
        np.arange(-3.0, 3.01, _SPACING_M), np.arange(-1.25, 1.26, _SPACING_M), np.arange(0.125, 2.4, _SPACING_M),
        indexing="ij",
    ),
    axis=-1,
).reshape(-1, 3)  # fmt: skip
"""Probe points (P, 3), metres, frame of `Surface`. Longer or higher vehicles are compared by the part among them."""


def fingerprint(surface: Surface) -> NDArray[np.uint8]:
    """Compute the distance (P,) of every probe to the surface, in 255ths of half a metre, at most half a metre."""
    return np.asarray(np.rint(surface.nearest_points_m(PROBES, _REACH_M) * (255.0 / _REACH_M)), np.uint8)


def nearest_by_fingerprint(
    own: NDArray[np.uint8], members: NDArray[np.uint8], count: int, left_out: int | None = None
) -> NDArray[np.int64]:
    """Return indices of the `count` members (M, P) nearest to `own` (P,) by fingerprint, in order; skip `left_out`."""
    differences = np.empty(len(members), np.int64)
    for start in range(0, len(members), 256):
        part = members[start : start + 256].astype(np.int16)
        differences[start : start + 256] = np.abs(part - own.astype(np.int16)).sum(axis=1, dtype=np.int64)
    if left_out is not None:
        differences[left_out] = np.iinfo(np.int64).max
    return np.argsort(differences, kind="stable")[: min(count, len(members) - (left_out is not None))]


FORMAT = "1"
CANDIDATES = 8
"""Number of members compared in full: those with the most similar fingerprints. Against a comparison with all 2,000
members of the wide family, 2 of 13 left-out members got another nearest member, at most 0.43 mm farther."""
_RANKED = 4  # candidates are compared with every fourth point
_STEP_M = 0.0005  # quantization of stored coordinates
_KEPT = 64  # cached surfaces with their trees, 0.5 MB each
_TENSORS = ("points", "normals", "disc_m", "size_m", "fingerprint")


@dataclass(frozen=True, eq=False)
class Member:
    """Vehicle of a reference set in its stored form.

    points: (POINTS, 3) int16, half millimetres. normals: (POINTS, 3) int8, 127ths. fingerprint: (P,) uint8.
    disc_m, size_m: see `Surface`.
    """

    name: str
    points: NDArray[np.int16]
    normals: NDArray[np.int8]
    disc_m: float
    size_m: tuple[float, float, float]
    fingerprint: NDArray[np.uint8]

    @staticmethod
    def of(name: str, surface: Surface) -> Member:
        """Build a member from its surface of POINTS points."""
        points = np.rint(surface.points / _STEP_M).astype(np.int16)
        normals = np.rint(surface.normals * 127.0).astype(np.int8)
        return Member(name, points, normals, surface.disc_m, surface.size_m, fingerprint(surface))

    def surface(self) -> Surface:
        """Return the surface, with coordinates rounded."""
        points, normals = self.points.astype(np.float64), self.normals.astype(np.float64)
        return Surface(points * _STEP_M, normals / 127.0, self.disc_m, self.size_m)


@dataclass(frozen=True)
class NearestMember:
    """Nearest member and its distances in centimetres. Each direction: (mean, 95th percentile) over the points.

    to_member: from the shape's points to the member's surface; large where the member lacks a part of the shape.
    from_member: from the member's points to the shape's surface; large where the shape lacks a part of the member.
    """

    index: int
    name: str
    to_member_cm: tuple[float, float]
    from_member_cm: tuple[float, float]

    @property
    def mean_cm(self) -> float:
        """Mean of the two directions' means: the symmetric Chamfer distance, see `sdf.meshes`."""
        return (self.to_member_cm[0] + self.from_member_cm[0]) / 2.0

    @property
    def p95_cm(self) -> float:
        """Larger of the two directions' 95th percentiles."""
        return max(self.to_member_cm[1], self.from_member_cm[1])


class ReferenceSet:
    """Reference set with members by index.

    Args:
        names: (M,). fingerprints: (M, P). surface_of: returns a member's surface by index.
        calibration: None while the calibration is computed.
    """

    def __init__(
        self,
        names: Sequence[str],
        fingerprints: NDArray[np.uint8],
        surface_of: Callable[[int], Surface],
        calibration: Calibration | None = None,
    ) -> None:
        self.names = tuple(names)
        self.fingerprints = fingerprints
        self.surface = functools.lru_cache(maxsize=_KEPT)(surface_of)
        self._calibration = calibration

    def __len__(self) -> int:
        return len(self.names)

    @property
    def calibration(self) -> Calibration:
        """Distances between members; see `Calibration`."""
        assert self._calibration is not None
        return self._calibration

    def nearest(self, shape: Surface, left_out: int | None = None, candidates: int = CANDIDATES) -> NearestMember:
        """Return the member whose surface is nearest in the mean of both directions.

        Args:
            shape: any surface. left_out: index of a member to skip.
            candidates: number of members compared in full; `len(self)` compares all.
        Source: our choice.
        """
        found = nearest_by_fingerprint(fingerprint(shape), self.fingerprints, candidates, left_out)
        best = int(min(found, key=lambda number: (_apart_m(shape, self.surface(int(number))), number)))
        member = self.surface(best)
        to_member, from_member = (
            (float(100.0 * apart.mean()), float(100.0 * np.quantile(apart, 0.95)))
            for apart in (member.distances_to(shape.points), shape.distances_to(member.points))
        )
        return NearestMember(best, self.names[best], to_member, from_member)


def _apart_m(a: Surface, b: Surface) -> float:
    """Compute the mean of both directions, metres, over every fourth point."""
    there, back = b.distances_to(a.points[::_RANKED]), a.distances_to(b.points[::_RANKED])
    return float(there.mean() + back.mean()) / 2.0


def leave_one_out_distance_cm(reference: ReferenceSet, number: int) -> tuple[float, float]:
    """Compute (mean, 95th percentile) in cm from a member to the nearest other member."""
    nearest = reference.nearest(reference.surface(number), left_out=number)
    return nearest.mean_cm, nearest.p95_cm


def write_reference(path: Path, members: Sequence[Member], calibration: Calibration) -> None:
    """Write a reference set to a file, atomically."""
    tensors: dict[str, NDArray[Any]] = {
        name: np.stack([np.asarray(getattr(member, name)) for member in members]) for name in _TENSORS
    }
    tensors |= {"calibration_mean_cm": calibration.mean_cm, "calibration_p95_cm": calibration.p95_cm}
    facts = {"format": FORMAT, "names": [member.name for member in members]}
    write_safetensors(path, tensors, {"reference": json.dumps(facts)})


def read_reference(path: Path) -> ReferenceSet:
    """Read a reference set; surfaces are read on demand. Raises: InputError for a missing, damaged or foreign file."""
    from safetensors import SafetensorError, safe_open

    refused = InputError("no reference set can be read", where=str(path), remedy="Delete it: it is made again")
    try:
        file: Any = safe_open(str(path), framework="np")
        facts = json.loads((file.metadata() or {})["reference"])
        names = facts["names"]
        fingerprints, disc_m, size_m = (file.get_tensor(name) for name in ("fingerprint", "disc_m", "size_m"))
        calibration = Calibration(file.get_tensor("calibration_mean_cm"), file.get_tensor("calibration_p95_cm"))
        points, normals = file.get_slice("points"), file.get_slice("normals")
        expected = [len(names), POINTS, 3]
        sound = facts["format"] == FORMAT and points.get_shape() == normals.get_shape() == expected
    except (SafetensorError, OSError, ValueError, TypeError, KeyError) as error:
        raise refused from error
    if not sound or len(fingerprints) != len(names):
        raise refused

    def surface_of(number: int) -> Surface:
        length, width, height = (float(side) for side in size_m[number])
        stored = points[number : number + 1][0], normals[number : number + 1][0]
        member = Member(names[number], *stored, float(disc_m[number]), (length, width, height), fingerprints[number])
        return member.surface()

    return ReferenceSet(names, fingerprints, surface_of, calibration)
