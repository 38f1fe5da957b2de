"""Vehicle set: a folder with vehicles.safetensors, its decoder sdf.safetensors, and sdf.json, for use in sweeps.

The files have the format of the shipped weights, so the same readers load both.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.sdf.decoder import Decoder, save_decoder
from shift3d.sdf.meshes import extract_mesh, symmetric_chamfer
from shift3d.seeding import generator
from shift3d.store.arrays import write_safetensors
from shift3d.store.atomic import write_atomic
from shift3d.vehicles.parameter_box import ParameterBox, parameter_tensors

VEHICLES_FILE, DECODER_FILE, FACTS_FILE = "vehicles.safetensors", "sdf.safetensors", "sdf.json"
RESOLUTION = 129  # nodes per axis of the unit sphere's cube for measured meshes: 4 cm apart for a car


@dataclass(frozen=True)
class FittedVehicle:
    """A latent code fitted to a mesh, with the fit's error.

    latent_code: float32 values. scale_m: metres per sdf unit. bounds_m: lowest and highest corner of the decoded
    surface, in the mesh's frame. pieces: connected components of the surface. chamfer_m: symmetric Chamfer distance
    between the surface and the mesh (`shift3d.sdf.meshes`).
    """

    name: str
    body_type: str
    latent_code: tuple[float, ...]
    scale_m: float
    bounds_m: tuple[tuple[float, ...], tuple[float, ...]]
    pieces: int
    chamfer_m: float

    def facts(self) -> dict[str, Any]:
        """Return the metadata that `shift3d.vehicles.vehicle` reads. The object frame's origin is the box's centre."""
        low, high = np.array(self.bounds_m)
        return {
            "body_type": self.body_type,
            "scale_m": self.scale_m,
            "sdf_R_object": np.eye(3).tolist(),
            "sdf_t_object": ((low + high) / 2.0 / self.scale_m).tolist(),
            "size_m": (high - low).tolist(),
            "pieces": self.pieces,
        }


def decode_and_measure(
    name: str, body_type: str, decoder: Decoder, code: NDArray[np.float32], scale_m: float, mesh: trimesh.Trimesh
) -> tuple[FittedVehicle, trimesh.Trimesh]:
    """Decode a code and measure the surface against its mesh. Returns the vehicle, and the surface in metres.

    Args: mesh: object frame, metres. Its box's centre is at the origin, which is also the origin of the sdf frame.
    Raises: InputError when the code decodes to no surface.
    """
    decoded = extract_mesh(decoder.field(torch.from_numpy(code)), RESOLUTION)
    decoded.vertices = decoded.vertices * scale_m
    chamfer_m = symmetric_chamfer(decoded, mesh, generator("chamfer", name))
    low, high = map(tuple, np.asarray(decoded.bounds, np.float64).tolist())
    pieces = int(decoded.body_count)
    return FittedVehicle(name, body_type, tuple(code.tolist()), scale_m, (low, high), pieces, chamfer_m), decoded


@dataclass(frozen=True)
class TrainingVehicles:
    """Vehicles that a decoder was trained on: body types or kinds, codes (N, code), scales (N,), sizes (N, 3)."""

    body_types: tuple[str, ...]
    codes: NDArray[np.float32]
    scale_m: NDArray[np.float32]
    size_m: NDArray[np.float32]


def write_vehicle_set(
    out: Path | str,
    decoder: Decoder | Path,
    vehicles: list[FittedVehicle],
    provenance: dict[str, Any],
    boxes: Mapping[str, ParameterBox] | None = None,
    known: TrainingVehicles | None = None,
) -> None:
    """Write the three files of a vehicle set to a folder, each atomically. The vehicles come last and complete the set.

    The file stores vehicles by name (`baseline_vehicles`), and the decoder's known codes in one table
    (`family_vehicles`): `known`, or else the same vehicles in the same order. boxes: by name, the parameters behind
    the codes. decoder: a file is copied byte for byte, so that results made with it refer to the same decoder.
    provenance: goes into sdf.json, together with the vehicles' distances from their meshes.
    Raises: InputError without vehicles, or when two have one name.
    """
    if len({vehicle.name for vehicle in vehicles}) != len(vehicles) or not vehicles:
        raise InputError("no vehicles, or two of one name", where=str(out), remedy="Give one file for every vehicle")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / VEHICLES_FILE).unlink(missing_ok=True)  # a kill must not leave old vehicles beside another decoder
    if isinstance(decoder, Decoder):
        save_decoder(decoder, folder / DECODER_FILE)
    else:
        write_atomic(folder / DECODER_FILE, decoder.read_bytes())
    chamfer_cm = [100.0 * vehicle.chamfer_m for vehicle in vehicles]
    median, worst = round(float(np.median(chamfer_cm)), 3), round(max(chamfer_cm), 3)
    measured = {"chamfer_median_cm": median, "chamfer_worst_cm": worst, "extraction_resolution": RESOLUTION}
    write_atomic(folder / FACTS_FILE, (json.dumps(provenance | measured, indent=1) + "\n").encode())
    baselines = {vehicle.name: vehicle.facts() for vehicle in vehicles}
    tensors = {f"{vehicle.name}.latent_code": np.array(vehicle.latent_code, np.float32) for vehicle in vehicles}
    for name, box in (boxes or {}).items():
        baselines[name]["parameters"] = list(box.names)
        tensors |= parameter_tensors(name, box)
    known = known or TrainingVehicles(
        tuple(vehicle.body_type for vehicle in vehicles),
        np.array([vehicle.latent_code for vehicle in vehicles], np.float32),
        np.array([vehicle.scale_m for vehicle in vehicles]),
        np.array([facts["size_m"] for facts in baselines.values()]),
    )
    tensors["family.codes"] = known.codes.astype(np.float32)
    tensors["family.scale_m"] = known.scale_m.astype(np.float32)
    tensors["family.size_m"] = known.size_m.astype(np.float32)
    types = list(known.body_types)
    family = {"body_types": types, "names": list(baselines), "count": len(types), "source": "meshes"}
    metadata = {"baselines": json.dumps(baselines), "family": json.dumps(family)}
    write_safetensors(folder / VEHICLES_FILE, tensors, metadata)
