"""Pool of vehicle meshes of the embedded family for each split of the streets, built once and cached on disk."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.street.raycast import Intersector
from shift3d.seeding import generator
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.store.user_cache import program_digest, user_cache

_SOURCES = ("vehicles", "seeding.py", "scenes/street/build/pool.py")
POOL_SIZES = {"train": 270, "val": 90, "test": 90}
RESOLUTION_M = 0.07
# Windows lie between these shares of a vehicle's height; some vehicles lose most of their windows' returns.
GLASS_FROM, GLASS_TO = 0.62, 0.92


@dataclass(frozen=True)
class PoolVehicle:
    """One vehicle ready for ray casting.

    Attributes:
        size_m: dx, dy, dz of the axis-aligned box; the object frame's origin is the box's centre.
        radius_m: radius of the smallest sphere about the origin around the vehicle.
        intersector: of the mesh, object frame.
        glass_band_m: lower and upper height of the windows, object frame; equal without windows.
        kind: body type and attributes of the wide family, "" for others.
    """

    size_m: NDArray[np.float64]
    radius_m: float
    intersector: Intersector
    glass_band_m: tuple[float, float]
    kind: str = ""


@lru_cache(maxsize=512)
def pool_vehicle(split: str, number: int) -> PoolVehicle:
    """Return vehicle ``number`` (modulo the pool size) of a split; the splits share no seed. Source: our choice."""
    number %= POOL_SIZES[split]
    vertices, faces = _cached_mesh(split, number)
    low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
    stretch = _stretch(generator("street-stretch", split, number))
    vertices = ((vertices - (low + high) / 2) * stretch).astype(np.float32)
    radius_m = float(np.linalg.norm(vertices, axis=1).max()) + 0.01
    size_m = (high - low) * stretch
    return PoolVehicle(size_m, radius_m, Intersector(vertices, faces), glass_band_m(float(size_m[2])))


def glass_band_m(height_m: float) -> tuple[float, float]:
    """Compute the lower and upper height of a car's windows from the middle of its height."""
    return GLASS_FROM * height_m - height_m / 2, GLASS_TO * height_m - height_m / 2


def _stretch(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw factors of length, width and height beside the family's variation: some towns have smaller cars."""
    small = rng.uniform()
    length = 1.05 - 0.22 * small + rng.uniform(-0.02, 0.02)
    width = 1.02 - 0.14 * small + rng.uniform(-0.02, 0.02)
    return np.array([length, width, rng.uniform(0.95, 1.06)])


def _build(split: str, number: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    from shift3d.vehicles.family import BODY_TYPES, build_mesh, sample_spec

    body_type = BODY_TYPES[number % len(BODY_TYPES)]
    mesh = build_mesh(sample_spec(body_type, generator("street-pool", split, number)), RESOLUTION_M)
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)


def _cached_mesh(split: str, number: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Load the mesh from the user's cache folder, or build and cache it."""
    path = cache_folder() / f"{split}-{number:03d}.npz"
    try:
        with read_arrays(path) as stored:
            return stored["vertices"], stored["faces"]
    except InputError:
        vertices, faces = _build(split, number)
        with contextlib.suppress(InputError, OSError):  # works without a cache if the folder is not writable
            write_arrays(path, vertices=vertices, faces=faces)
        return vertices, faces


def cache_folder() -> Path:
    """Return the folder of pool meshes in XDG_CACHE_HOME/shift3d, keyed by the code and libraries that shape them."""
    return user_cache() / f"street-pool-{RESOLUTION_M}-{program_digest(*_SOURCES)[:16]}"
