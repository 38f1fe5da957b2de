"""Fleet of a street: vehicles of the embedded family or of the wide family."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from shift3d.scenes.street.build.item import Size
from shift3d.scenes.street.build.pool import PoolVehicle, glass_band_m, pool_vehicle
from shift3d.scenes.street.options import check_split
from shift3d.scenes.street.raycast import Intersector
from shift3d.seeding import derive_seed

if TYPE_CHECKING:
    from shift3d.vehicles.family.wide import WideSpec

WIDE_RESOLUTION_M = 0.06
_WITHOUT_GLASS = ("trailer", "box_van", "camper")
"""Body types with sheet metal at the height of a car's windows."""
_FAMILY_SLOT_M = (5.7, 2.1, 1.8)
"""Slot as long and wide as nearly all vehicles of the embedded family, to 0.15 m; vans are up to 0.3 m higher."""


@dataclass(frozen=True)
class Fleet:
    """Vehicles of a street, by the variant number of an item.

    slot_m: reserved floor space and height of a vehicle, metres; does not build the mesh. vehicle: the vehicle.
    """

    slot_m: Callable[[int], Size]
    vehicle: Callable[[int], PoolVehicle]


def fleet_of(traffic: str, split: str) -> Fleet:
    """Return the fleet for a street's option `traffic`. Raises InputError: as `check_split`.

    family: pool of vehicles of the embedded family, see `pool`. wide, held_out: vehicles of the wide family, a
    different one for each variant; the splits share none. held_out: every second vehicle has an unseen kind.
    """
    check_split(split, traffic)
    if traffic == "family":
        return Fleet(lambda variant: _FAMILY_SLOT_M, functools.partial(pool_vehicle, split))
    held_out = traffic == "held_out"
    return Fleet(
        lambda variant: _wide_spec(split, held_out, variant).size_m, functools.partial(_wide_vehicle, split, held_out)
    )


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
    """Source: our choice. Not cached on disk: a mesh takes some 30 ms to build, and hardly any is needed twice."""
    from shift3d.vehicles.family.spec import VehicleSpec
    from shift3d.vehicles.family.wide import build_wide_mesh

    spec = _wide_spec(split, held_out, variant)
    mesh = build_wide_mesh(spec, WIDE_RESOLUTION_M)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    size_m = np.array(spec.size_m)
    glass = (0.0, 0.0)
    if spec.body_type not in _WITHOUT_GLASS and isinstance(spec.chassis, VehicleSpec):
        # The windows are those of the car without its roof load, measured from the middle of the whole height.
        shift = (spec.chassis.height_m - float(size_m[2])) / 2
        low, high = glass_band_m(spec.chassis.height_m)
        glass = (low + shift, high + shift)
    radius_m = float(np.linalg.norm(vertices, axis=1).max()) + 0.01
    return PoolVehicle(size_m, radius_m, Intersector(vertices, faces), glass, spec.kind)
