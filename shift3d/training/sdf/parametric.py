"""Training of a decoder whose codes are a linear map of the generator's parameters: z = features @ basis.

Codes of an auto-decoder hold whatever lowers the loss; part of a code says nothing about its vehicle, and attacks
exploit that part. Codes of this decoder hold the vehicle's parameters and nothing else, and untrained vehicles have
codes too. The resulting vehicle set holds a typical vehicle of every kind, with its open parameters.
Source: our choice. Loss, optimiser and samples are DeepSDF's (Park et al. 2019, section 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.sdf.decoder import Architecture, Decoder, load_decoder
from shift3d.sdf.deepsdf_network import parameters_of
from shift3d.sdf.meshes import extract_mesh, symmetric_chamfer
from shift3d.seeding import derive_seed, generator
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.compute import Compute, restore_subnormals
from shift3d.training.progress import Report
from shift3d.training.provenance import versions
from shift3d.training.sdf.export import CODE_NORM
from shift3d.training.sdf.loop import DecoderRun, run_to_end
from shift3d.training.sdf.wide_shapes import WideShapes, in_frame, wide_shapes, wide_specs
from shift3d.vehicles.family.split import SPLIT
from shift3d.vehicles.family.wide import WideSpec, build_wide_mesh, wide_vehicle
from shift3d.vehicles.parameter_box import ParameterBox
from shift3d.vehicles.vehicle_set import TrainingVehicles, decode_and_measure, write_vehicle_set

CHECKPOINT = "parametric.pt"
LEAST_MEMBERS = 8  # fewest training members of a kind that gives a vehicle of the set
TRIMMED = 0.02  # share of a kind's members beyond either end of a parameter's range
UNSEEN = 24
RESOLUTION_M = 0.03


@dataclass(frozen=True)
class ParametricRecipe:
    """Everything that decides the weights, beside the samples.

    shapes, samples_a_shape: vehicles, half seen and half held out, and samples of each. shapes_a_step, points_a_shape:
    of a batch. start: "shipped" for the shipped network, "" for random weights. basis_std: of the initial basis.
    """

    shapes: int = 1200
    samples_a_shape: int = 16_000
    shapes_a_step: int = 360
    points_a_shape: int = 24
    steps: int = 5_000
    seed: int = 7
    network_rate: float = 8e-4
    basis_rate: float = 8e-4
    clamp: float = 0.1
    basis_std: float = 0.01
    start: str = "shipped"
    bfloat16: bool = True


class ParametricRun(DecoderRun):
    """One training of a decoder and of the basis that maps features to codes."""

    table_name = "basis"

    def __init__(self, recipe: ParametricRecipe, shapes: WideShapes, compute: Compute) -> None:
        torch.manual_seed(derive_seed("parametric sdf training", recipe.seed) % 2**63)
        decoder = Decoder(Architecture())
        if recipe.start == "shipped":
            _take_weights(decoder, load_decoder())
        basis = torch.randn(shapes.features.shape[1], decoder.architecture.code_length) * recipe.basis_std
        self.shapes, self.rates = shapes, (recipe.network_rate, recipe.basis_rate)
        super().__init__(recipe, decoder, basis, compute, recipe.bfloat16)

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        recipe, shapes = self.recipe, self.shapes
        rng = np.random.default_rng([recipe.seed, self.step])
        chosen = np.sort(rng.choice(len(shapes.features), recipe.shapes_a_step, replace=False))
        start = int(rng.integers(shapes.points.shape[1] - recipe.points_a_shape + 1))
        taken = slice(start, start + recipe.points_a_shape)
        points = shapes.points[chosen, taken].copy()
        mirrored = shapes.symmetric[chosen, None] & (rng.random(points.shape[:2]) < 0.5)
        points[..., 1] = np.where(mirrored, -points[..., 1], points[..., 1])
        arrays = (shapes.features[chosen], points, shapes.distances[chosen, taken].copy())
        features, tensor, target = (torch.from_numpy(array).to(self.compute.device) for array in arrays)
        return features @ self.table, tensor, target


def _take_weights(decoder: Decoder, start: Decoder) -> None:
    """Copy weights from a folded decoder to one with weight norm, so that both compute the same."""
    with torch.no_grad():
        for layer, other in zip(decoder.layers, start.layers, strict=True):
            weight, bias = parameters_of(other)
            layer.weight = weight.detach().clone()
            parameters_of(layer)[1].copy_(bias)


def train_parametric(
    out: Path,
    recipe: ParametricRecipe,
    shapes: WideShapes,
    compute: Compute,
    checkpoint_every: int = 250,
    report: Report | None = None,
) -> Path:
    """Train, or resume, and write the checkpoint (decoder, basis, recipe) to `out`. Returns its path.

    Raises: InputError when `out` holds another recipe's training; KeyboardInterrupt on SIGINT or SIGTERM.
    """
    compute.prepare()
    file = out / CHECKPOINT
    run_to_end(ParametricRun(recipe, shapes, compute), file, checkpoint_every, report)
    return file


@restore_subnormals()
def train_wide_family(
    out: Path, compute: Compute, count: int | None = None, steps: int | None = None, report: Report | None = None
) -> list[float]:
    """Sample the wide family, train, and write the vehicle set to `out`. Returns its Chamfer distances in cm.

    count, steps: None for the recipe's. Raises: InputError: another training in `out`, or no kind with enough vehicles.
    """
    recipe = ParametricRecipe()
    recipe = replace(recipe, shapes=count or recipe.shapes, steps=steps or recipe.steps)
    recipe = replace(recipe, shapes_a_step=min(recipe.shapes_a_step, recipe.shapes))
    members_by_kind(wide_specs(recipe.shapes, recipe.seed))  # refuses too few members before anything is made
    shapes = wide_shapes(recipe.shapes, recipe.samples_a_shape, recipe.seed, out / "shapes", compute.threads)
    checkpoint = train_parametric(out, recipe, shapes, compute, report=report)
    return list(export_parametric(checkpoint, shapes, out).values())


def export_parametric(checkpoint: Path, shapes: WideShapes, out: Path) -> dict[str, float]:
    """Write the vehicle set to `out`. Returns Chamfer distances in cm by the names of its vehicles.

    Codes have the mean length of the shipped codes, see `export.CODE_NORM`.
    Raises: InputError if no kind has enough members, or a code has no surface.
    Source: our choice.
    """
    state = read_checkpoint(checkpoint)
    decoder = Decoder()
    decoder.load_state_dict(state["decoder"])
    basis = state["basis"].numpy().astype(np.float32)
    codes = shapes.features @ basis
    factor = np.float32(CODE_NORM / np.linalg.norm(codes, axis=1).mean())
    basis, codes = basis * factor, codes * factor
    decoder.folded().eval().requires_grad_(False).with_code_scale(float(factor))
    vehicles, boxes = [], {}
    kinds = members_by_kind(shapes.specs).items()
    for kind, members in progress_bar(kinds, desc="measuring vehicles", unit="vehicle"):
        index = _typical(shapes.features[members], members)
        spec, frame = shapes.specs[index], shapes.frames[kind]
        mesh = in_frame(spec, frame, build_wide_mesh(spec, RESOLUTION_M))
        mesh.vertices *= frame.scale_m
        name = kind.replace("+", "_with_")
        vehicles.append(decode_and_measure(name, spec.body_type, decoder, codes[index].copy(), frame.scale_m, mesh)[0])
        boxes[name] = _box(shapes, basis, index, members)
    known = TrainingVehicles(
        tuple(spec.kind for spec in shapes.specs),
        codes,
        np.array([shapes.frames[spec.kind].scale_m for spec in shapes.specs], np.float32),
        np.array([spec.size_m for spec in shapes.specs], np.float32),
    )
    chamfer_cm = {vehicle.name: 100.0 * vehicle.chamfer_m for vehicle in vehicles}
    unseen = unseen_chamfer_cm(decoder, basis, shapes)
    provenance = {
        "model": "DeepSDF decoder, codes a linear map of the wide family's parameters",
        "recipe": state["recipe"],
        "step": state["step"],
        "loss_every_100_steps": [round(float(loss), 6) for loss in state["losses"]],
        "training_seconds": round(float(state["seconds"]), 1),
        "vehicles": {"made_by": "the wide family, both sides", **SPLIT.to_dict()},
        "parameters": list(shapes.table.names),
        "chamfer_cm": {name: round(value, 3) for name, value in chamfer_cm.items()},
        "unseen_chamfer_cm": {kind: round(value, 3) for kind, value in unseen.items()},
        "versions": versions(),
    }
    write_vehicle_set(out, decoder, vehicles, provenance, boxes, known)
    return chamfer_cm


def unseen_chamfer_cm(decoder: Decoder, basis: NDArray[np.float32], shapes: WideShapes) -> dict[str, float]:
    """Compute Chamfer distances in cm of untrained vehicles, by index and kind: their codes need no fit."""
    found = {}
    rng = generator("unseen wide vehicles")
    for index in range(UNSEEN):
        side = "seen" if index % 2 == 0 else "held_out"
        spec = wide_vehicle(len(shapes.specs) + index, int(rng.integers(2**31)), side)  # type: ignore[arg-type]
        frame = shapes.frames.get(spec.kind)
        if frame is None:
            continue
        code = torch.from_numpy((shapes.table.row(spec).astype(np.float32)) @ basis)
        mesh = in_frame(spec, frame, build_wide_mesh(spec, RESOLUTION_M))
        apart = symmetric_chamfer(extract_mesh(decoder.field(code), 129), mesh, generator("unseen chamfer", spec.kind))
        found[f"{index} {spec.kind}"] = 100.0 * frame.scale_m * apart
    return found


def members_by_kind(specs: Sequence[WideSpec]) -> dict[str, NDArray[np.int64]]:
    """Return the members of each kind with enough of them, in order of appearance. Raises: InputError: no such kind."""
    kinds = np.array([spec.kind for spec in specs])
    found = {str(kind): np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds)}
    enough = {kind: members for kind, members in found.items() if len(members) >= LEAST_MEMBERS}
    if not enough:
        raise InputError(f"no kind has {LEAST_MEMBERS} members", "wide family", "Give a larger count=")
    return enough


def _typical(features: NDArray[np.float32], members: NDArray[np.int64]) -> int:
    """Return the member nearest to the median of its kind."""
    return int(members[np.square(features - np.median(features, axis=0)).sum(axis=1).argmin()])


def _box(shapes: WideShapes, basis: NDArray[np.float32], index: int, members: NDArray[np.int64]) -> ParameterBox:
    """Return the parameters in which a vehicle's kind varies, and their ranges."""
    of_kind, own = shapes.features[members].astype(np.float64), shapes.features[index].astype(np.float64)
    low = np.minimum(np.quantile(of_kind, TRIMMED, axis=0), own)
    high = np.maximum(np.quantile(of_kind, 1.0 - TRIMMED, axis=0), own)
    # A panel exists or not: such flags do not vary by degrees.
    lengths = [not name.startswith(("is:", "has:", "MissingPanels.")) for name in shapes.table.names]
    open_ones = np.flatnonzero((high - low > 1e-3) & np.array(lengths))
    names = tuple(shapes.table.names[number] for number in open_ones)
    values = (own, low, high)
    start, low, high = (np.asarray(value[open_ones], np.float32).astype(np.float64) for value in values)
    return ParameterBox(basis[open_ones], start, low, high, names)
