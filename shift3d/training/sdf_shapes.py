"""Training shapes of the decoder: vehicles of the family, sampled once and cached in a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.processes import each
from shift3d.progress_bar import progress_bar
from shift3d.sdf.samples import bounding_scale, sample_sdf
from shift3d.seeding import generator
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.store.user_cache import program_digest
from shift3d.vehicles.family import VehicleSpec, build_mesh, family

_CODE = ("sdf/samples.py", "seeding.py", "training/sdf_shapes.py", "vehicles/family")


@dataclass(frozen=True)
class ShapeSamples:
    """Samples of S shapes, P each: points (S, P, 3), distances (S, P), float32, sdf units; scale_m (S,) float64.

    source: "family", or an identifier of the sampled meshes.
    """

    points: NDArray[np.float32]
    distances: NDArray[np.float32]
    scale_m: NDArray[np.float64]
    source: str = "family"


def sample_shuffled(
    mesh: trimesh.Trimesh, samples: int, name: str, *key: str | int
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """Sample a mesh. Returns points, distances, in random order, and scale. name, key: of the generators."""
    result = sample_sdf(mesh, samples, generator(f"{name} samples", *key))
    order = generator(f"{name} sample order", *key).permutation(len(result.points))
    return result.points[order], result.distances[order], result.scale_m


def _sampled(task: tuple[VehicleSpec, int, int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    spec, samples, seed, index = task
    return sample_shuffled(build_mesh(spec), samples, "sdf", seed, index)


def shape_samples(shapes: int, samples: int, seed: int, cache: Path, processes: int) -> ShapeSamples:
    """Sample the training shapes, or read them from `cache` (a folder) if it holds the same samples.

    Samples of another program version are not reused. The samples of a shape are in random order, so that consecutive
    slices are fair batches.
    """
    file = cache / f"shapes-{shapes}-{samples}-{seed}-{program_digest(*_CODE)[:16]}.npz"
    if not file.is_file():
        tasks = [(spec, samples, seed, index) for index, spec in enumerate(family(shapes, seed))]
        work = each(_sampled, tasks, processes)
        parts = list(progress_bar(work, total=shapes, desc="sampling shapes", unit="shape"))
        points, distances, scale_m = (np.array(values) for values in zip(*parts, strict=True))
        write_arrays(file, points=points, distances=distances, scale_m=scale_m)
    with read_arrays(file) as data:
        return ShapeSamples(data["points"], data["distances"], data["scale_m"])


def shape_scales(shapes: int, seed: int, cache: Path) -> NDArray[np.float64]:
    """Return metres per sdf unit (S,) of the training shapes: from the cached samples, or else from the meshes."""
    for file in sorted(cache.glob(f"shapes-{shapes}-*-{seed}-{program_digest(*_CODE)[:16]}.npz")):
        with read_arrays(file) as data:
            return np.asarray(data["scale_m"], np.float64)
    return np.array([bounding_scale(build_mesh(spec)) for spec in family(shapes, seed)])
