"""Vehicles from meshes by a decoder as it is: each mesh's code found by auto-decoding, and the vehicle set of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar, write_line
from shift3d.sdf.autodecode import autodecode
from shift3d.sdf.decoder import DEFAULT_WEIGHTS, Decoder, load_decoder
from shift3d.sdf.samples import SdfSamples, sample_sdf
from shift3d.seeding import generator
from shift3d.vehicles.mesh_files import MeshFile, MeshVehicle, find_meshes, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.orientation import better_frame, turned
from shift3d.vehicles.picture import write_side_by_side
from shift3d.vehicles.repair import RepairReport
from shift3d.vehicles.vehicle import CODE_LENGTH
from shift3d.vehicles.vehicle_set import FittedVehicle, fitted, write_vehicle_set
from shift3d.wording import counted

SAMPLES, STEPS, POINTS_A_STEP = 50_000, 300, 1_024
PICTURES = "pictures"
USUAL, WORST_USUAL = 0.0042, 0.008
"""Distances from the mesh, as shares of the vehicle's length: the median and the worst of 19 cars that the shipped
decoder does not know (1.9 cm and 3.6 cm of 4.5 m)."""


@dataclass(frozen=True)
class MeshFit:
    """A vehicle fitted to a mesh, and what speaks against it.

    picture: the mesh beside what the decoder makes of it. better: another orientation and the distance in metres with
    which the decoder draws the mesh, where that is nearer. repair: what it took to close the mesh.
    """

    vehicle: FittedVehicle
    picture: Path
    better: tuple[MeshFrame, float] | None
    repair: RepairReport

    @property
    def usual_m(self) -> float:
        """How far vehicles of this length usually are from their meshes."""
        return USUAL * float(np.ptp(self.vehicle.decoded.vertices[:, 0]))

    @property
    def far(self) -> bool:
        """Whether it is farther from its mesh than any car that the shipped decoder was tried on."""
        return self.vehicle.chamfer_m > WORST_USUAL / USUAL * self.usual_m


def fit_meshes(
    path: Path | str, frame: MeshFrame, out: Path | str, decoder_file: Path | str | None = None, steps: int = STEPS
) -> list[MeshFit]:
    """Find a code for every mesh at a path and write the vehicle set, with a picture of each beside its mesh.

    Args:
        path: a mesh, or a folder (`find_meshes`). frame: its orientation and scale.
        out: folder of the vehicle set, whose sdf.json says what was repaired and how far each code is off.
        decoder_file: default the shipped one. It draws what it was trained on, and nothing far from that well.
        steps: of the search for a code.
    Returns: the fits, sorted by name. On stderr it says how far it is.
    Raises: InputError for a mesh that cannot be used; among several, such a mesh is left out and said so.
    """
    source = Path(decoder_file).expanduser() if decoder_file is not None else DEFAULT_WEIGHTS
    decoder = load_decoder(source)
    if (length := decoder.architecture.code_length) != CODE_LENGTH:
        remedy = f"Give a decoder of codes of length {CODE_LENGTH}, as a vehicle set holds them"
        raise InputError(f"codes of length {length}", str(source), remedy)
    files = find_meshes(path)
    fits: list[MeshFit] = []
    facts: list[dict[str, Any]] = []
    refused: dict[str, str] = {}
    bar = progress_bar(files, desc="fitting meshes", unit="mesh", disable=len(files) == 1)

    def say(text: str) -> None:
        """Beside the bar, or in a line of its own."""
        if bar.disable:
            write_line(text)
        else:
            bar.set_postfix_str(text, refresh=sys.stderr.isatty())

    for file in bar:
        try:
            fit, known = _fit(file, frame, decoder, steps, Path(out), say)
        except InputError as error:
            if len(files) == 1:
                raise
            refused[str(file.path)] = str(error)
            bar.write(f"left out: {error}")
            continue
        fits.append(fit)
        facts.append(known)
    if not fits:
        first = next(iter(refused.values()))
        raise InputError(f"none of {len(files)} meshes can be used", str(path), f"Repair them, as the first: {first}")
    provenance = {
        "model": "codes auto-decoded from meshes",
        "decoder": str(source),
        "steps": steps,
        "points_a_step": POINTS_A_STEP,
        "frame": asdict(frame),
        "vehicles": facts,
        "refused": refused,
    }
    write_vehicle_set(out, source, [fit.vehicle for fit in fits], provenance)
    return fits


def _fit(
    file: MeshFile, frame: MeshFrame, decoder: Decoder, steps: int, out: Path, say: Callable[[str], None]
) -> tuple[MeshFit, dict[str, Any]]:
    """One mesh. say: told each stage from when the file is read."""
    start = time.monotonic()
    vehicle = read_mesh_vehicle(file, frame)
    say(f"{vehicle.name}: measuring distances to its surface")
    samples = sample_sdf(vehicle.mesh, SAMPLES, generator("mesh fit", vehicle.name))
    say(f"{vehicle.name}: searching its code, {counted(steps, 'step')}")
    code = autodecode(decoder, samples, steps=steps, batch=POINTS_A_STEP).numpy()
    say(f"{vehicle.name}: drawing the code")
    try:
        done = fitted(vehicle.name, vehicle.body_type, decoder, code, samples.scale_m, vehicle.mesh)
    except InputError as error:
        remedy = "Give more steps=, or another decoder="
        raise InputError("the decoder draws no surface for it", str(file.path), remedy) from error
    say(f"{vehicle.name}: trying other orientations")
    better = _better(done, vehicle, frame, decoder, samples, steps)
    picture = out / PICTURES / f"{vehicle.name}.png"
    write_side_by_side(picture, vehicle.mesh, done.decoded)
    facts = {
        **vehicle.facts(),
        "sha256": file.sha256(),
        "chamfer_cm": round(100.0 * done.chamfer_m, 3),
        "better_orientation": better
        and {"forward": better[0].forward, "up": better[0].up, "chamfer_cm": round(100.0 * better[1], 3)},
        "code_norm": round(float(np.linalg.norm(code)), 4),
        "seconds": round(time.monotonic() - start, 1),
    }
    return MeshFit(done, picture, better, vehicle.repair), facts


def _better(
    done: FittedVehicle, vehicle: MeshVehicle, frame: MeshFrame, decoder: Decoder, samples: SdfSamples, steps: int
) -> tuple[MeshFrame, float] | None:
    """Another orientation, and its distance in metres, where that is shorter than what was found."""
    other = better_frame(decoder, samples, frame)
    if other is None:
        return None
    mesh = trimesh.Trimesh(turned(vehicle.mesh.vertices, frame, other), vehicle.mesh.faces, process=False)
    samples = replace(samples, points=turned(samples.points, frame, other))
    code = autodecode(decoder, samples, steps=steps, batch=POINTS_A_STEP).numpy()
    try:
        chamfer_m = fitted(done.name, done.body_type, decoder, code, samples.scale_m, mesh).chamfer_m
    except InputError:  # that way round it draws no surface
        return None
    return (other, chamfer_m) if chamfer_m < done.chamfer_m else None
