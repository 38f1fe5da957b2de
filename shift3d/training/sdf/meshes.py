"""Meshes of vehicles from files as training shapes: read, repaired and sampled once, and kept in a file."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.sdf.samples import sample_sdf
from shift3d.seeding import generator
from shift3d.store.arrays import write_arrays
from shift3d.training.sdf_shapes import ShapeSamples
from shift3d.vehicles.mesh_files import MeshFile, MeshVehicle, find_meshes, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame

_VERSION = 2
"""Raised when the file of samples comes to hold something else."""


@dataclass(frozen=True)
class MeshShapes:
    """Samples of S meshes, and by the same index what is known of each.

    facts: per shape, as JSON values: name, file, sha256, repair, size_m, seconds. refused: what could not be used,
    and why, by file.
    """

    samples: ShapeSamples
    facts: list[dict[str, Any]]
    refused: dict[str, str]


def mesh_shapes(path: Path | str, frame: MeshFrame, samples: int, seed: int, cache: Path, processes: int) -> MeshShapes:
    """Sample the meshes at a path, or read them back from `cache` (a folder) when it holds just these.

    A mesh that cannot be used is left out and said so, once; the samples of a shape are in random order, so that
    consecutive slices are fair batches.
    Raises: InputError when there are no meshes at the path, or none that can be used.
    """
    files = find_meshes(path)
    hashes = [file.sha256() for file in files]
    request = json.dumps(
        [_VERSION, asdict(frame), samples, seed, [[f.name, h] for f, h in zip(files, hashes)]], sort_keys=True
    )
    source = "meshes-" + hashlib.blake2b(request.encode(), digest_size=8).hexdigest()
    kept = cache / f"{source}.npz"
    if not kept.is_file():
        tasks = [(file, frame, samples, seed) for file in files]
        with ProcessPoolExecutor(min(processes, len(files))) as pool:
            parts = list(tqdm(pool.map(_sampled, tasks), total=len(tasks), desc="sampling meshes", mininterval=5.0))
        _keep(kept, parts, files, hashes)
    with np.load(kept, allow_pickle=False) as data:
        facts = json.loads(str(data["facts"]))
        arrays = ShapeSamples(data["points"], data["distances"], data["scale_m"], source)
    places = {file.name: str(file.path) for file in files}  # the folder may have moved since
    shapes = [{**shape, "file": places[shape["name"]]} for shape in facts["shapes"]]
    refused = {places[name]: f"{places[name]}: {why}" for name, why in facts["refused"].items()}
    return MeshShapes(arrays, shapes, refused)


_Part = tuple[NDArray[np.float32], NDArray[np.float32], float, dict[str, Any]]


def _sampled(task: tuple[MeshFile, MeshFrame, int, int]) -> _Part | str:
    file, frame, samples, seed = task
    try:
        vehicle = read_mesh_vehicle(file, frame)
    except InputError as error:
        return str(error)
    return (*_in_random_order(vehicle, samples, seed), vehicle.facts())


def _in_random_order(
    vehicle: MeshVehicle, samples: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    result = sample_sdf(vehicle.mesh, samples, generator("mesh samples", seed, vehicle.name))
    order = generator("mesh sample order", seed, vehicle.name).permutation(len(result.points))
    return result.points[order], result.distances[order], result.scale_m


def _keep(kept: Path, parts: list[_Part | str], files: list[MeshFile], hashes: list[str]) -> None:
    left_out = [(file, part) for file, part in zip(files, parts) if isinstance(part, str)]
    for _, reason in left_out:
        print(f"left out: {reason}")
    refused = {file.name: reason.removeprefix(f"{file.path}: ") for file, reason in left_out}
    used = [(part, digest) for part, digest in zip(parts, hashes) if not isinstance(part, str)]
    if not used:
        what = f"none of {len(files)} meshes can be used, the first: {left_out[0][1]}"
        raise InputError(what, where=str(kept.parent))
    shapes = [{**part[3], "sha256": digest} for part, digest in used]
    points, distances, scale_m = (np.array(values) for values in zip(*(part[:3] for part, _ in used), strict=True))
    facts = np.array(json.dumps({"shapes": shapes, "refused": refused}))
    write_arrays(kept, points=points, distances=distances, scale_m=scale_m, facts=facts)
