"""From a parametric training to a vehicle set: a typical vehicle of every kind, with its open parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.meshes import extract_mesh, symmetric_chamfer
from shift3d.seeding import generator
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.provenance import versions
from shift3d.training.sdf.export import CODE_NORM
from shift3d.training.sdf.wide_shapes import KindFrame, WideShapes, in_frame
from shift3d.vehicles.family.split import SPLIT
from shift3d.vehicles.family.wide import WideSpec, build_wide_mesh, wide_vehicle
from shift3d.vehicles.parameter_box import BoxOfParameters
from shift3d.vehicles.vehicle_set import KnownCodes, fitted, write_vehicle_set

LEAST_MEMBERS = 8
"""Fewest members of a kind in the training that make it a vehicle of the set."""
TRIMMED = 0.02
"""Share of its kind's members beyond either end of a parameter's range."""
UNSEEN = 24
RESOLUTION_M = 0.03


def parametric_decoder(checkpoint: Path) -> tuple[Decoder, NDArray[np.float32], dict[str, Any]]:
    """The folded decoder, the basis (F, code) in its units, and the checkpoint's state.

    Codes are as long as the shipped ones are, see `export.CODE_NORM`, by the recipe's own features.
    Raises: InputError where there is no checkpoint.
    """
    state = read_checkpoint(checkpoint)
    if state is None:
        raise InputError("no such checkpoint", str(checkpoint), "shift3d train model=sdf vehicles=wide")
    decoder = Decoder()
    decoder.load_state_dict(state["decoder"])
    return decoder.folded().eval().requires_grad_(False), state["basis"].numpy().astype(np.float32), state


def export_parametric(checkpoint: Path, shapes: WideShapes, out: Path) -> dict[str, float]:
    """Write the vehicle set to `out`; returns Chamfer distances in cm by the names of its vehicles.

    Raises: InputError where no kind has enough members, or a code draws no surface.
    Source: our choice.
    """
    decoder, basis, state = parametric_decoder(checkpoint)
    codes = shapes.features @ basis
    factor = np.float32(CODE_NORM / np.linalg.norm(codes, axis=1).mean())
    basis, codes = basis * factor, codes * factor
    decoder.with_code_scale(float(factor))
    vehicles, boxes = [], {}
    for kind, members in tqdm(members_by_kind(shapes.specs).items(), desc="measuring vehicles", mininterval=5.0):
        index = _typical(shapes.features[members], members)
        spec, frame = shapes.specs[index], shapes.frames[kind]
        mesh = in_frame(spec, frame, build_wide_mesh(spec, RESOLUTION_M))
        mesh.vertices *= frame.scale_m
        name = kind.replace("+", "_with_")
        vehicles.append(fitted(name, spec.body_type, decoder, codes[index].copy(), frame.scale_m, mesh))
        boxes[name] = _box(shapes, basis, index, members)
    known = KnownCodes(
        tuple(spec.kind for spec in shapes.specs),
        codes,
        np.array([shapes.frames[spec.kind].scale_m for spec in shapes.specs], np.float32),
        np.array([spec.size_m for spec in shapes.specs], np.float32),
    )
    chamfer_cm = {vehicle.name: 100.0 * vehicle.chamfer_m for vehicle in vehicles}
    unseen = generalisation_cm(decoder, basis, shapes)
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


def generalisation_cm(decoder: Decoder, basis: NDArray[np.float32], shapes: WideShapes) -> dict[str, float]:
    """Chamfer distances in cm of vehicles that were never trained on, by index and kind: their codes need no fit."""
    found = {}
    rng = generator("unseen wide vehicles")
    for index in range(UNSEEN):
        side = "seen" if index % 2 == 0 else "held_out"
        spec = wide_vehicle(len(shapes.specs) + index, int(rng.integers(2**31)), side)  # type: ignore[arg-type]
        frame = shapes.frames.get(spec.kind)
        if frame is None:
            continue
        code = torch.from_numpy((shapes.table.row(spec).astype(np.float32)) @ basis)
        found[f"{index} {spec.kind}"] = _distance_cm(decoder, code, spec, frame)
    return found


def _distance_cm(decoder: Decoder, code: torch.Tensor, spec: WideSpec, frame: KindFrame) -> float:
    mesh = in_frame(spec, frame, build_wide_mesh(spec, RESOLUTION_M))
    decoded = extract_mesh(decoder.field(code), 129)
    return 100.0 * frame.scale_m * symmetric_chamfer(decoded, mesh, generator("unseen chamfer", spec.kind))


def members_by_kind(specs: Sequence[WideSpec]) -> dict[str, NDArray[np.int64]]:
    """Members by kind, of kinds with enough of them, in the order of their first. Raises: InputError: there is none."""
    kinds = np.array([spec.kind for spec in specs])
    found = {str(kind): np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds)}
    enough = {kind: members for kind, members in found.items() if len(members) >= LEAST_MEMBERS}
    if not enough:
        raise InputError(f"no kind has {LEAST_MEMBERS} members", "wide family", "Give a larger count=")
    return enough


def _typical(features: NDArray[np.float32], members: NDArray[np.int64]) -> int:
    """The member nearest to the median of its kind."""
    return int(members[np.square(features - np.median(features, axis=0)).sum(axis=1).argmin()])


def _box(shapes: WideShapes, basis: NDArray[np.float32], index: int, members: NDArray[np.int64]) -> BoxOfParameters:
    """The parameters in which a vehicle's kind varies, and how far."""
    of_kind, own = shapes.features[members].astype(np.float64), shapes.features[index].astype(np.float64)
    low = np.minimum(np.quantile(of_kind, TRIMMED, axis=0), own)
    high = np.maximum(np.quantile(of_kind, 1.0 - TRIMMED, axis=0), own)
    # A panel is there or not: whether it is does not vary by degrees.
    lengths = [not name.startswith(("is:", "has:", "MissingPanels.")) for name in shapes.table.names]
    open_ones = np.flatnonzero((high - low > 1e-3) & np.array(lengths))
    names = tuple(shapes.table.names[number] for number in open_ones)
    values = (own, low, high)
    start, low, high = (np.asarray(value[open_ones], np.float32).astype(np.float64) for value in values)
    return BoxOfParameters(basis[open_ones], start, low, high, names)
