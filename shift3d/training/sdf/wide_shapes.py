"""Training shapes of the wide family, for a decoder whose codes are computed from the generator's parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.processes import each
from shift3d.progress_bar import progress_bar
from shift3d.sdf.samples import SPHERE_MARGIN, sample_sdf_within
from shift3d.seeding import generator
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.store.user_cache import program_digest
from shift3d.vehicles.family.parameters import ParameterTable, is_symmetric, parameter_table
from shift3d.vehicles.family.wide import WideSpec, build_wide_mesh, wide_family

_CODE = ("sdf/samples.py", "seeding.py", "training/sdf/wide_shapes.py", "vehicles/family")
CHUNK = 100
RESOLUTION_M, FACES = 0.035, 30_000
KIND_MARGIN = 1.03  # factor by which vehicles of a kind may exceed the largest training vehicle


@dataclass(frozen=True)
class KindFrame:
    """SDF frame shared by all vehicles of a kind, so that their parameters alone tell them apart.

    x_sdf = (x - (0, 0, middle_m)) / scale_m, x in the family's working frame: origin on the ground, halfway along.
    """

    scale_m: float
    middle_m: float


@dataclass(frozen=True)
class WideShapes:
    """Samples of S vehicles: points (S, P, 3), distances (S, P), float32, sdf units of their kinds' frames.

    features: (S, F) float32, rows of the vehicles in `table`. symmetric: (S,) True if left and right are alike.
    """

    specs: tuple[WideSpec, ...]
    points: NDArray[np.float32]
    distances: NDArray[np.float32]
    features: NDArray[np.float32]
    symmetric: NDArray[np.bool_]
    table: ParameterTable
    frames: dict[str, KindFrame]


def kind_frames(specs: Sequence[WideSpec]) -> dict[str, KindFrame]:
    """Return the frame of every kind among the vehicles: the sphere that holds the kind's largest vehicle."""
    middles: dict[str, float] = {}
    for spec in specs:
        middles[spec.kind] = max(middles.get(spec.kind, 0.0), spec.size_m[2] / 2)
    radii: dict[str, float] = {}
    for spec in specs:
        low, high = spec.bounds_m
        reach = [*np.maximum(-low[:2], high[:2]), max(middles[spec.kind], high[2] - middles[spec.kind])]
        radii[spec.kind] = max(radii.get(spec.kind, 0.0), float(np.linalg.norm(reach)))
    return {kind: KindFrame(radii[kind] * SPHERE_MARGIN * KIND_MARGIN, middles[kind]) for kind in radii}


def wide_specs(count: int, seed: int) -> list[WideSpec]:
    """Return `count` vehicles of the wide family, half seen and half held out."""
    return [*wide_family(count - count // 2, seed, "seen"), *wide_family(count // 2, seed, "held_out")]


def wide_shapes(count: int, samples: int, seed: int, cache: Path, processes: int) -> WideShapes:
    """Sample `count` vehicles, half seen and half held out, or read the samples from `cache`, a folder.

    An interrupted call resumes. Samples of another program version are not reused.
    Source: samples as of Park et al. 2019; frames are our choice.
    """
    specs = wide_specs(count, seed)
    frames = kind_frames(specs)
    tasks = [(spec, frames[spec.kind], samples, seed, index) for index, spec in enumerate(specs)]
    folder = cache / f"wide-{count}-{samples}-{seed}-{program_digest(*_CODE)[:16]}"
    chunks = {folder / f"{start:06d}.npz": tasks[start : start + CHUNK] for start in range(0, count, CHUNK)}
    missing = {file: some for file, some in chunks.items() if not file.is_file()}
    work = each(_sampled, [task for some in missing.values() for task in some], processes)
    parts = []
    with progress_bar(total=count, desc="sampling vehicles", unit="vehicle") as bar:
        for file, some in chunks.items():
            if file in missing:
                points, distances = (np.stack(arrays) for arrays in zip(*islice(work, len(some)), strict=True))
                write_arrays(file, points=points, distances=distances)
            bar.update(len(some))
            with read_arrays(file) as data:
                parts.append((data["points"], data["distances"]))
    table = parameter_table(specs)
    return WideShapes(
        tuple(specs),
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        table.rows(specs).astype(np.float32),
        np.array([is_symmetric(spec) for spec in specs]),
        table,
        frames,
    )


def in_frame(spec: WideSpec, frame: KindFrame, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Transform a vehicle's mesh, centred as by `build_wide_mesh`, to its kind's sdf frame."""
    low, high = spec.bounds_m
    offset = (low + high) / 2 - (0.0, 0.0, frame.middle_m)
    return trimesh.Trimesh((mesh.vertices + offset) / frame.scale_m, mesh.faces, process=False)


def _sampled(task: tuple[WideSpec, KindFrame, int, int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    spec, frame, samples, seed, index = task
    unit = in_frame(spec, frame, build_wide_mesh(spec, RESOLUTION_M, FACES))
    points, distances = sample_sdf_within(unit, samples, generator("wide sdf samples", seed, index))
    order = generator("wide sdf sample order", seed, index).permutation(len(points))
    return points[order], distances[order]
