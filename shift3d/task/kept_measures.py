"""How natural the unchanged vehicles of a set are, in the user's cache folder: half a second a vehicle, once a machine.

A measure from there has the bits that this process would compute: its name changes with the decoder, the vehicles, the
reference set, the code that measures and what decides rounding on this machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from shift3d.errors import InputError
from shift3d.naturalness.measure import Naturalness, NaturalnessMeasure
from shift3d.naturalness.reference import Nearest
from shift3d.naturalness.sizes import Sizes
from shift3d.processor import rounding
from shift3d.progress_bar import progress_bar
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.deepsdf_network import DeepSdfNetwork
from shift3d.store.atomic import write_atomic
from shift3d.store.user_cache import source_digest, user_cache
from shift3d.vehicles.sources import VehicleSource, vehicle_hash
from shift3d.vehicles.vehicle import Vehicle

_CODE = ("naturalness", "sdf", "processor.py", "task/kept_measures.py", "vehicles/vehicle.py")


def kept_measures(
    source: VehicleSource, decoder: Decoder | DeepSdfNetwork, measures: Naturalness, reference: str, show: bool = False
) -> dict[str, NaturalnessMeasure]:
    """The naturalness of every kind of a set, by name, from the cache folder; measured, and kept there, where it holds
    none.

    reference: hash of the reference set. show: a progress bar while it measures.
    A file that is torn or changed is made again; a folder that cannot be written is done without.
    """
    vehicles = [source.vehicle(name) for name in source.kinds()]
    path = _file(source.decoder_hash(), vehicles, reference)
    try:
        return _read(path)
    except (OSError, ValueError, KeyError, TypeError):
        bar = progress_bar(vehicles, desc="measuring how natural each vehicle is", unit="vehicle", disable=not show)
        found = {vehicle.name: measures.of_code(vehicle, decoder, vehicle.latent_code) for vehicle in bar}
        with contextlib.suppress(InputError, OSError):
            _write(path, found)
        return found


def _file(decoder_hash: str, vehicles: Sequence[Vehicle], reference: str) -> Path:
    made_of = (
        decoder_hash,
        [vehicle_hash(vehicle) for vehicle in vehicles],
        reference,
        source_digest(*_CODE),
        rounding(),
    )
    return user_cache() / "natural_kinds" / f"{_digest(repr(made_of))}.json"


def _write(path: Path, found: dict[str, NaturalnessMeasure]) -> None:
    text = json.dumps({name: asdict(measure) for name, measure in found.items()})  # floats to the bit
    write_atomic(path, f"{_digest(text)}\n{text}".encode())


def _read(path: Path) -> dict[str, NaturalnessMeasure]:
    digest, text = path.read_text().split("\n")
    if _digest(text) != digest:
        raise ValueError("its bytes have changed")
    return {name: _measure(**values) for name, values in json.loads(text).items()}


def _measure(nearest: dict[str, Any] | None, sizes: dict[str, float] | None, **values: Any) -> NaturalnessMeasure:
    if nearest is None or sizes is None:
        return NaturalnessMeasure(None, None, **values)
    directions = {name: tuple(nearest[name]) for name in ("to_member_cm", "from_member_cm")}
    return NaturalnessMeasure(Nearest(**nearest | directions), Sizes(**sizes), **values)


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
