"""Training of a decoder on vehicles from mesh files, and the resulting vehicle set.

Meshes are read, repaired and sampled once, and the samples of each mesh are cached in a file.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.processes import each
from shift3d.processor import has_fast_bfloat16
from shift3d.progress_bar import progress_bar
from shift3d.sdf.decoder import Decoder
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.store.atomic import write_atomic
from shift3d.store.user_cache import digest_of, program_digest
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.compute import Compute, restore_subnormals
from shift3d.training.progress import Report
from shift3d.training.provenance import versions
from shift3d.training.sdf.export import scaled_decoder
from shift3d.training.sdf.train import SdfRecipe, train_sdf
from shift3d.training.sdf_shapes import ShapeSamples, sample_shuffled
from shift3d.vehicles.fit import PICTURES
from shift3d.vehicles.mesh_files import MeshFile, find_meshes, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.picture import side_by_side
from shift3d.vehicles.vehicle_set import FACTS_FILE, VEHICLES_FILE, FittedVehicle, decode_and_measure, write_vehicle_set

STEPS = 5_000
POINTS_A_STEP = 2_750
NETWORK_RATE, CODE_RATE = 8e-4, 2e-3
SAMPLES_A_SHAPE = 100_000
SEED = 7
_VERSION = 2  # of the text that identifies meshes in a recipe
_CODE = ("sdf/samples.py", "seeding.py", "training/sdf_shapes.py", "vehicles")


@dataclass(frozen=True)
class MeshShapes:
    """Samples of S meshes, and facts about each mesh at the same index.

    facts: per shape, as JSON values: name, file, sha256, repair, size_m. refused: reasons by file of unusable meshes.
    """

    samples: ShapeSamples
    facts: list[dict[str, Any]]
    refused: dict[str, str]


def mesh_shapes(path: Path | str, frame: MeshFrame, samples: int, seed: int, cache: Path, processes: int) -> MeshShapes:
    """Sample the meshes at a path; a mesh that `cache` (a folder) holds is not sampled again.

    `cache` has a file for every mesh, so a killed call resumes. Samples of another program version are not reused. An
    unusable mesh is left out, and the reason is printed once. The samples of a shape are in random order, so that
    consecutive slices are fair batches.
    Raises: InputError when there are no meshes at the path, or none that can be used.
    """
    files = find_meshes(path)
    hashes = [file.sha256() for file in files]
    request = json.dumps(
        [_VERSION, asdict(frame), samples, seed, [[f.name, h] for f, h in zip(files, hashes)]], sort_keys=True
    )
    source = "meshes-" + hashlib.blake2b(request.encode(), digest_size=8).hexdigest()
    made_with = frame, samples, seed, program_digest(*_CODE)
    kept = [cache / f"{digest_of(f.name, h, *made_with)}.npz" for f, h in zip(files, hashes)]
    missing = [(file, place) for file, place in zip(files, kept) if not place.is_file()]
    work = each(partial(_sample, frame, samples, seed), missing, processes)
    shown = {"total": len(files), "initial": len(files) - len(missing), "disable": not missing}
    with progress_bar(work, desc="sampling meshes", unit="mesh", **shown) as bar:
        for why in bar:
            if why:
                bar.write(f"left out: {why}")
    shapes, refused, parts = [], dict[str, str](), []
    for file, digest, place in zip(files, hashes, kept):
        with read_arrays(place) as data:
            facts = json.loads(str(data["facts"]))
            if why := facts.get("refused"):
                refused[str(file.path)] = f"{file.path}: {why}"
                continue
            parts.append((data["points"], data["distances"], data["scale_m"]))
        shapes.append({**facts, "file": str(file.path), "sha256": digest})  # the folder may have moved since
    if not parts:
        what = f"none of {len(files)} meshes can be used, the first: {next(iter(refused.values()))}"
        raise InputError(what, where=str(path))
    points, distances, scale_m = (np.array(values) for values in zip(*parts, strict=True))
    return MeshShapes(ShapeSamples(points, distances, scale_m, source), shapes, refused)


def _sample(frame: MeshFrame, samples: int, seed: int, missing: tuple[MeshFile, Path]) -> str:
    """Write the samples of a mesh, or the reason why it cannot be used, to a file. Returns the reason, or ""."""
    file, place = missing
    try:
        vehicle = read_mesh_vehicle(file, frame)
    except InputError as error:
        why = str(error).removeprefix(f"{file.path}: ")
        write_arrays(place, facts=np.array(json.dumps({"refused": why})))
        return str(error)
    points, distances, scale_m = sample_shuffled(vehicle.mesh, samples, "mesh", seed, vehicle.name)
    facts = np.array(json.dumps(vehicle.facts()))
    write_arrays(place, points=points, distances=distances, scale_m=scale_m, facts=facts)
    return ""


def mesh_recipe(shapes: MeshShapes, steps: int) -> SdfRecipe:
    """Return the recipe for meshes: an hour on one core without bfloat16 allows fewer points per step, at higher rates.

    The published rates are for ten to a hundred times as many steps. Meshes are not mirrored: few are symmetric.
    """
    count, held, _ = shapes.samples.points.shape
    return SdfRecipe(
        shapes=count,
        samples_a_shape=held,
        batch_a_shape=min(max(8, POINTS_A_STEP // count), held // 2),
        steps=steps,
        seed=SEED,
        network_rate=NETWORK_RATE,
        code_rate=CODE_RATE,
        compute="bfloat16" if has_fast_bfloat16() else "float32",
        source=shapes.samples.source,
        mirror=False,
    )


@restore_subnormals()
def train_on_meshes(
    path: Path | str, frame: MeshFrame, out: Path, compute: Compute, steps: int = STEPS, report: Report | None = None
) -> list[float]:
    """Train a decoder of the published size on the meshes at a path, or resume; write the vehicle set to `out`.

    The shipped weights stay. A vehicle set that this training already wrote is not made again.
    Returns: Chamfer distances of the vehicles to their meshes, cm, in the order of the meshes.
    Raises: InputError for meshes that cannot be used (see `mesh_shapes`), or another training's folder.
    """
    shapes = mesh_shapes(path, frame, SAMPLES_A_SHAPE, SEED, out / "shapes", compute.threads)
    recipe = mesh_recipe(shapes, steps)
    checkpoint = train_sdf(out, recipe, 250, shapes.samples, compute, report)
    if not is_exported(checkpoint, out):
        export_mesh_training(checkpoint, shapes, frame, out, compute.threads)
    facts = json.loads((out / FACTS_FILE).read_text(encoding="utf-8"))
    return [vehicle["chamfer_cm"] for vehicle in facts["vehicles"]]


def is_exported(checkpoint: Path, out: Path) -> bool:
    """True if `out` holds the vehicle set of the checkpoint's recipe, which names the meshes, and of its step."""
    if not (out / VEHICLES_FILE).is_file():
        return False
    state = read_checkpoint(checkpoint)
    try:
        facts = json.loads((out / FACTS_FILE).read_text(encoding="utf-8"))
        return bool((facts["recipe"], facts["step"]) == (state["recipe"], state["step"]))
    except (OSError, ValueError, KeyError):
        return False


def export_mesh_training(checkpoint: Path, shapes: MeshShapes, frame: MeshFrame, out: Path, processes: int) -> None:
    """Decode every training shape, measure it against its mesh, picture both, and write the vehicle set.

    A code without a surface, as after a few steps, is left out, and the reason is printed. Processes share the shapes.
    Raises: InputError when no code has a surface.
    """
    state = read_checkpoint(checkpoint)
    decoder, codes, _ = scaled_decoder(state)
    vehicles, known, refused = [], [], dict(shapes.refused)
    rows = list(zip(shapes.facts, codes, shapes.samples.scale_m, strict=True))
    measured = each(partial(_measured, frame, out / PICTURES), rows, processes, partial(_decoder, checkpoint))
    with progress_bar(measured, total=len(rows), desc="measuring vehicles", unit="vehicle") as bar:
        for (facts, _, _), done in zip(rows, bar, strict=True):
            if isinstance(done, str):
                refused[facts["file"]] = done
                bar.write(f"left out: {facts['name']}: {done}")
                continue
            vehicles.append(done)
            known.append({**facts, "chamfer_cm": round(100.0 * done.chamfer_m, 3)})
    if not vehicles:
        first = next(iter(refused.values()))
        what = f"after {state['step']} steps no vehicle has a surface, the first because {first}"
        raise InputError(what, where=str(checkpoint), remedy="Train longer: give steps=, and another out=")
    provenance = {
        "model": "DeepSDF auto-decoder, trained on meshes",
        "recipe": state["recipe"],
        "step": state["step"],
        "frame": asdict(frame),
        "training_seconds": round(float(state.get("seconds", 0.0)), 1),
        "loss_every_100_steps": [round(float(loss), 6) for loss in state["losses"]],
        "vehicles": known,
        "refused": refused,
        "versions": versions(),
    }
    write_vehicle_set(out, decoder, vehicles, provenance)


def _decoder(checkpoint: Path) -> Decoder:
    return scaled_decoder(read_checkpoint(checkpoint))[0]


_Row = tuple[dict[str, Any], NDArray[np.float32], float]


def _measured(frame: MeshFrame, pictures: Path, decoder: Decoder, row: _Row) -> FittedVehicle | str:
    """Return the vehicle of a code, and write its picture beside its mesh; or return the error text."""
    facts, code, scale_m = row
    try:
        vehicle = read_mesh_vehicle(MeshFile(facts["name"], Path(facts["file"])), frame)
        done, decoded = decode_and_measure(vehicle.name, vehicle.body_type, decoder, code, float(scale_m), vehicle.mesh)
    except InputError as error:
        return str(error)
    write_atomic(pictures / f"{vehicle.name}.png", side_by_side(vehicle.mesh, decoded))
    return done
