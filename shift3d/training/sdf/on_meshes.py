"""A decoder trained on vehicles from mesh files, and the vehicle set that comes of it."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.processor import has_fast_bfloat16
from shift3d.sdf.decoder import Decoder
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.compute import Compute
from shift3d.training.progress import Report
from shift3d.training.sdf.export import CODE_NORM
from shift3d.training.sdf.meshes import MeshShapes, mesh_shapes
from shift3d.training.sdf.train import SdfRecipe, train_sdf
from shift3d.vehicles.fit import PICTURES
from shift3d.vehicles.mesh_files import MeshFile, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.picture import write_side_by_side
from shift3d.vehicles.vehicle_set import RESOLUTION, FittedVehicle, fitted, write_vehicle_set

STEPS = 5_000
POINTS_A_STEP = 2_750
NETWORK_RATE, CODE_RATE = 8e-4, 2e-3
SAMPLES_A_SHAPE = 100_000
SEED = 7


def mesh_recipe(shapes: MeshShapes, steps: int) -> SdfRecipe:
    """The recipe for meshes: an hour on one core that has no bfloat16, so fewer points a step, and higher rates.

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


def train_on_meshes(
    path: Path | str,
    frame: MeshFrame,
    out: Path,
    compute: Compute,
    steps: int = STEPS,
    report: Report | None = None,
) -> list[FittedVehicle]:
    """Train a decoder of the published size on the meshes at a path, or go on; leave the vehicle set in `out`.

    Nothing is written to the shipped weights. Returns the vehicles, in the order of the meshes.
    Raises: InputError for meshes that cannot be used (see `mesh_shapes`), or another training's folder.
    """
    start = time.monotonic()
    shapes = mesh_shapes(path, frame, SAMPLES_A_SHAPE, SEED, out / "shapes", compute.threads)
    recipe = mesh_recipe(shapes, steps)
    checkpoint = train_sdf(out, recipe, 250, shapes.samples, compute, report)
    seconds = time.monotonic() - start
    return export_mesh_training(checkpoint, shapes, frame, out, seconds)


def export_mesh_training(
    checkpoint: Path, shapes: MeshShapes, frame: MeshFrame, out: Path, seconds: float
) -> list[FittedVehicle]:
    """Decode every training shape, measure it against its mesh, picture both, and write the vehicle set.

    A code that draws no surface, as after a few steps, is left out and said so.
    Raises: InputError when none draws one.
    """
    state = read_checkpoint(checkpoint)
    assert state is not None
    decoder, codes = _scaled(state)
    vehicles, known, refused = [], [], dict(shapes.refused)
    rows = zip(shapes.facts, codes, shapes.samples.scale_m, strict=True)
    for facts, code, scale_m in tqdm(rows, total=len(codes), desc="measuring vehicles", mininterval=5.0):
        try:
            vehicle = read_mesh_vehicle(MeshFile(facts["name"], Path(facts["file"])), frame)
            done = fitted(vehicle.name, vehicle.body_type, decoder, code, float(scale_m), vehicle.mesh)
        except InputError as error:
            refused[facts["file"]] = str(error)
            tqdm.write(f"left out: {facts['name']}: {error}")
            continue
        write_side_by_side(out / PICTURES / f"{vehicle.name}.png", vehicle.mesh, done.decoded)
        vehicles.append(done)
        known.append({**facts, "chamfer_cm": round(100.0 * done.chamfer_m, 3)})
    if not vehicles:
        first = next(iter(refused.values()))
        what = f"after {state['step']} steps no vehicle has a surface, the first because {first}"
        raise InputError(what, where=str(checkpoint), remedy="train longer: steps=, in another out=")
    chamfer_cm = [facts["chamfer_cm"] for facts in known]
    provenance = {
        "model": "DeepSDF auto-decoder, trained on meshes",
        "recipe": state["recipe"],
        "step": state["step"],
        "frame": asdict(frame),
        "chamfer_median_cm": float(np.median(chamfer_cm)),
        "chamfer_worst_cm": float(np.max(chamfer_cm)),
        "extraction_resolution": RESOLUTION,
        "training_seconds": round(float(state.get("seconds", seconds)), 1),
        "loss_every_100_steps": [round(float(loss), 6) for loss in state["losses"]],
        "vehicles": known,
        "refused": refused,
        "torch": torch.__version__,
    }
    write_vehicle_set(out, decoder, vehicles, provenance)
    return vehicles


def _scaled(state: dict[str, Any]) -> tuple[Decoder, NDArray[np.float32]]:
    """Decoder and codes of a checkpoint, the codes as long as the shipped ones are: see CODE_NORM."""
    decoder = Decoder()
    decoder.load_state_dict(state["decoder"])
    codes: NDArray[np.float32] = state["codes"].numpy().astype(np.float32)
    factor = CODE_NORM / float(np.linalg.norm(codes, axis=1).mean())
    decoder = decoder.folded().eval().requires_grad_(False).with_code_scale(factor)
    return decoder, (codes * np.float32(factor)).astype(np.float32)
