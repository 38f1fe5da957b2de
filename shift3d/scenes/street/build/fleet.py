"""Whose vehicles drive and park on a street: those of the embedded family, or of the wide one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

from shift3d.scenes.street.build.item import Size
from shift3d.scenes.street.build.pool import PoolVehicle, glass_band_m, pool_vehicle
from shift3d.scenes.street.options import check_traffic
from shift3d.scenes.street.raycast import Intersector
from shift3d.seeding import derive_seed

if TYPE_CHECKING:
    from shift3d.vehicles.family.wide import WideSpec

WIDE_RESOLUTION_M = 0.06
_WITHOUT_GLASS = ("trailer", "box_van", "camper")
"""Boxes: at the height of a car's windows they have sheet metal."""


class Fleet(Protocol):
    """The vehicles of a street, by the variants that items carry."""

    def slot_m(self, variant: int) -> Size:
        """Floor space to keep for a vehicle, and its height, metres; no mesh is built for it."""
        ...

    def vehicle(self, variant: int) -> PoolVehicle:
        """The vehicle itself."""
        ...


@dataclass(frozen=True)
class EmbeddedFleet:
    """A pool of vehicles of the embedded family, see `pool`. Every slot is as long and wide as nearly any of them, to
    0.15 m; vans are up to 0.3 m higher."""

    split: str

    def slot_m(self, variant: int) -> Size:
        """See `Fleet`."""
        return (5.7, 2.1, 1.8)

    def vehicle(self, variant: int) -> PoolVehicle:
        """See `Fleet`."""
        return pool_vehicle(self.split, variant)


@dataclass(frozen=True)
class WideFleet:
    """Vehicles of the wide family, each variant another one; the splits share none.

    held_out: every second vehicle is of a kind that training never sees, the others of kinds that it does.
    """

    split: str
    held_out: bool = False

    def slot_m(self, variant: int) -> Size:
        """See `Fleet`."""
        return _wide_spec(self.split, self.held_out, variant).size_m

    def vehicle(self, variant: int) -> PoolVehicle:
        """See `Fleet`."""
        return _wide_vehicle(self.split, self.held_out, variant)


def fleet_of(traffic: str, split: str) -> Fleet:
    """The fleet of a street's option `traffic`. Raises InputError for held-out traffic on split train."""
    check_traffic(traffic, split)
    return EmbeddedFleet(split) if traffic == "family" else WideFleet(split, traffic == "held_out")


@lru_cache(maxsize=4096)
def _wide_spec(split: str, held_out: bool, variant: int) -> WideSpec:
    from shift3d.vehicles.family.wide import wide_vehicle

    seed = derive_seed("wide traffic", split)
    if not held_out:
        return wide_vehicle(variant, seed, "seen")
    index, odd = divmod(variant, 2)
    return wide_vehicle(index, seed, "held_out" if odd else "seen")


@lru_cache(maxsize=64)
def _wide_vehicle(split: str, held_out: bool, variant: int) -> PoolVehicle:
    """Source: our choice. Not kept on disk: building a mesh takes some 30 ms, and hardly one is met twice."""
    from shift3d.vehicles.family.spec import VehicleSpec
    from shift3d.vehicles.family.wide import build_wide_mesh

    spec = _wide_spec(split, held_out, variant)
    mesh = build_wide_mesh(spec, WIDE_RESOLUTION_M)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    size_m = np.array(spec.size_m)
    glass = (0.0, 0.0)
    if spec.body_type not in _WITHOUT_GLASS and isinstance(spec.chassis, VehicleSpec):
        # The windows are the car's own, whatever stands on its roof: from the middle of the whole height.
        shift = (spec.chassis.height_m - float(size_m[2])) / 2
        low, high = glass_band_m(spec.chassis.height_m)
        glass = (low + shift, high + shift)
    radius_m = float(np.linalg.norm(vertices, axis=1).max()) + 0.01
    return PoolVehicle(spec.body_type, size_m, radius_m, Intersector(vertices, faces), glass, spec.kind)
