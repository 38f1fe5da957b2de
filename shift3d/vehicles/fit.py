"""Fit of a vehicle set to meshes: a frozen decoder and one auto-decoded latent code per mesh."""

from __future__ import annotations

import contextlib
import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pydantic import TypeAdapter

from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar, write_line
from shift3d.sdf.autodecode import autodecode
from shift3d.sdf.decoder import DEFAULT_WEIGHTS, Decoder, load_decoder
from shift3d.sdf.samples import SdfSamples, sample_sdf
from shift3d.seeding import generator
from shift3d.store.atomic import write_atomic
from shift3d.store.user_cache import digest_of, program_digest, read_cached, write_cached
from shift3d.vehicles.mesh_files import MeshFile, MeshVehicle, find_meshes, read_mesh_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.orientation import better_frame, reorient_points
from shift3d.vehicles.picture import side_by_side
from shift3d.vehicles.repair import RepairReport
from shift3d.vehicles.vehicle import CODE_LENGTH
from shift3d.vehicles.vehicle_set import FittedVehicle, decode_and_measure, write_vehicle_set
from shift3d.wording import counted

SAMPLES, STEPS, POINTS_A_STEP = 50_000, 300, 1_024
PICTURES, KEPT = "pictures", "kept"
_CODE = ("vehicles", "sdf", "seeding.py", "processor.py")
USUAL, WORST_CHAMFER_SHARE = 0.0042, 0.008
"""Chamfer distance over vehicle length: median and maximum of 19 cars that the shipped decoder was not trained on
(1.9 cm and 3.6 cm of 4.5 m)."""


@dataclass(frozen=True)
class MeshFit:
    """A vehicle fitted to a mesh, with the diagnostics of the fit.

    better: another orientation and its Chamfer distance in metres, if the decoder fits the mesh better in it.
    repair: report of the mesh's repair. facts: for sdf.json.
    """

    vehicle: FittedVehicle
    better: tuple[MeshFrame, float] | None
    repair: RepairReport
    facts: dict[str, Any]

    @property
    def picture(self) -> Path:
        """Path, below the set's folder, of the picture of the mesh beside the decoded surface."""
        return Path(PICTURES) / f"{self.vehicle.name}.png"

    @property
    def typical_chamfer_m(self) -> float:
        """Usual Chamfer distance in metres for a vehicle of this length."""
        return USUAL * (self.vehicle.bounds_m[1][0] - self.vehicle.bounds_m[0][0])

    @property
    def far(self) -> bool:
        """True if the Chamfer distance exceeds that of every car that the shipped decoder was tried on."""
        return self.vehicle.chamfer_m > WORST_CHAMFER_SHARE / USUAL * self.typical_chamfer_m


def fit_meshes(
    path: Path | str, frame: MeshFrame, out: Path | str, decoder_file: Path | str | None = None, steps: int = STEPS
) -> list[MeshFit]:
    """Fit a code to every mesh at a path and write the vehicle set, with a picture of each mesh beside its fit.

    ``out``/kept caches the fit of each mesh, or the reason why it was refused; a mesh that is given alone is not cached
    if it is refused. A repeated call fits only the meshes whose cache entry is missing or damaged, or whose file,
    decoder or program version has changed. The result is the same with and without a kill.

    Args:
        path: a mesh, or a folder (`find_meshes`). frame: orientation and scale of the meshes.
        out: folder of the vehicle set; its sdf.json lists the repairs and each code's Chamfer distance.
        decoder_file: default the shipped decoder. A decoder draws only shapes near its training data well.
        steps: optimizer steps of the search for a code.
    Returns: the fits, sorted by name. Progress goes to stderr.
    Raises: InputError for an unusable mesh; among several meshes an unusable one is left out and reported.
    """
    source = Path(decoder_file).expanduser() if decoder_file is not None else DEFAULT_WEIGHTS
    decoder = load_decoder(source)
    if (length := decoder.architecture.code_length) != CODE_LENGTH:
        remedy = f"Give a decoder of codes of length {CODE_LENGTH}, as a vehicle set holds them"
        raise InputError(f"codes of length {length}", str(source), remedy)
    files = find_meshes(path)
    folder = Path(out)
    made_with = frame, steps, hashlib.blake2b(source.read_bytes()).hexdigest(), program_digest(*_CODE)

    def kept(file: MeshFile) -> Path:
        return folder / KEPT / digest_of(file, file.sha256(), *made_with)

    outcomes = TypeAdapter[MeshFit | str](MeshFit | str)  # str: why a mesh was refused
    fits, refused = dict[MeshFile, tuple[MeshFit, bytes]](), dict[MeshFile, str]()
    for file in files:
        with contextlib.suppress(InputError):  # the fit below reports the error
            if content := read_cached(kept(file)):
                text, _, picture = content.partition(b"\n")
                if isinstance(outcome := outcomes.validate_python(json.loads(text)), MeshFit):
                    fits[file] = outcome, picture
                elif len(files) > 1:
                    refused[file] = outcome
    left = [file for file in files if file not in fits and file not in refused]
    shown = {"total": len(files), "initial": len(fits) + len(refused), "disable": len(files) == 1}
    bar = progress_bar(left, desc="fitting meshes", unit="mesh", **shown)

    def say(text: str) -> None:
        """Print beside the progress bar, or on a separate line if the bar is off."""
        if bar.disable:
            write_line(text)
        else:
            bar.set_postfix_str(text, refresh=sys.stderr.isatty())

    for why in refused.values():
        bar.write(f"left out: {why}")
    for file in bar:
        place = None
        try:
            place = kept(file)  # before the fit reads the file: a file that changes meanwhile is fitted again
            fit, picture = fits[file] = _fit(file, frame, decoder, steps, say)
        except InputError as error:
            if len(files) == 1:
                raise
            refused[file] = str(error)
            bar.write(f"left out: {error}")
            if place is not None:  # the file can be read, so that a change of it shows
                write_cached(place, json.dumps(refused[file]).encode() + b"\n")
            continue
        # Not pydantic's JSON: it is UTF-8, which a file name need not be.
        write_cached(place, json.dumps(asdict(fit)).encode() + b"\n" + picture)
    if not fits:
        first = refused[files[0]]
        raise InputError(f"none of {len(files)} meshes can be used", str(path), f"Repair them, as the first: {first}")
    found = [fits[file] for file in files if file in fits]
    provenance = {
        "model": "codes auto-decoded from meshes",
        "decoder": str(source),
        "steps": steps,
        "points_a_step": POINTS_A_STEP,
        "frame": asdict(frame),
        "vehicles": [fit.facts for fit, _ in found],
        "refused": {str(file.path): refused[file] for file in files if file in refused},
    }
    for fit, picture in found:
        write_atomic(folder / fit.picture, picture)
    write_vehicle_set(folder, source, [fit.vehicle for fit, _ in found], provenance)
    return [fit for fit, _ in found]


def _fit(
    file: MeshFile, frame: MeshFrame, decoder: Decoder, steps: int, say: Callable[[str], None]
) -> tuple[MeshFit, bytes]:
    """Fit one mesh and draw its picture as PNG. say: receives the name of each stage."""
    sha256 = file.sha256()
    vehicle = read_mesh_vehicle(file, frame)
    say(f"{vehicle.name}: measuring distances to its surface")
    samples = sample_sdf(vehicle.mesh, SAMPLES, generator("mesh fit", vehicle.name))
    say(f"{vehicle.name}: searching its code, {counted(steps, 'step')}")
    code = autodecode(decoder, samples, steps=steps, batch=POINTS_A_STEP).numpy()
    say(f"{vehicle.name}: drawing the code")
    try:
        done, decoded = decode_and_measure(
            vehicle.name, vehicle.body_type, decoder, code, samples.scale_m, vehicle.mesh
        )
    except InputError as error:
        remedy = "Give more steps=, or another decoder="
        raise InputError("the decoder draws no surface for it", str(file.path), remedy) from error
    say(f"{vehicle.name}: trying other orientations")
    better = _better_orientation(done, vehicle, frame, decoder, samples, steps)
    facts = {
        **vehicle.facts(),
        "sha256": sha256,
        "chamfer_cm": round(100.0 * done.chamfer_m, 3),
        "better_orientation": better
        and {"forward": better[0].forward, "up": better[0].up, "chamfer_cm": round(100.0 * better[1], 3)},
        "code_norm": round(float(np.linalg.norm(code)), 4),
    }
    return MeshFit(done, better, vehicle.repair, facts), side_by_side(vehicle.mesh, decoded)


def _better_orientation(
    done: FittedVehicle, vehicle: MeshVehicle, frame: MeshFrame, decoder: Decoder, samples: SdfSamples, steps: int
) -> tuple[MeshFrame, float] | None:
    """Return another orientation and its Chamfer distance in metres, if that distance is smaller than `done`'s."""
    other = better_frame(decoder, samples, frame)
    if other is None:
        return None
    mesh = trimesh.Trimesh(reorient_points(vehicle.mesh.vertices, frame, other), vehicle.mesh.faces, process=False)
    samples = replace(samples, points=reorient_points(samples.points, frame, other))
    code = autodecode(decoder, samples, steps=steps, batch=POINTS_A_STEP).numpy()
    try:
        chamfer_m = decode_and_measure(done.name, done.body_type, decoder, code, samples.scale_m, mesh)[0].chamfer_m
    except InputError:  # the code decodes to no surface in this orientation
        return None
    return (other, chamfer_m) if chamfer_m < done.chamfer_m else None
