"""Disk cache of the naturalness of unchanged vehicles, in the user's cache folder: saves half a second per vehicle.

A cached measure has the bits that this process would compute: its file name depends on the decoder, the vehicles, the
reference set, the code and libraries that measure, and everything that decides rounding on the machine.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from shift3d.naturalness.measure import NaturalnessMeasure, NaturalnessMeter
from shift3d.naturalness.reference import NearestMember
from shift3d.naturalness.sizes import Sizes
from shift3d.progress_bar import progress_bar
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.deepsdf_network import DeepSdfNetwork
from shift3d.store.user_cache import cache_file, cache_result, program_digest, read_cached
from shift3d.vehicles.sources import VehicleSource, vehicle_hash

# Code that measures, and code that makes the reference set.
_CODE = ("naturalness", "sdf", "vehicles", "processor.py", "seeding.py", "task/measure_cache.py")


def cached_measures(
    source: VehicleSource,
    decoder: Decoder | DeepSdfNetwork,
    measures: NaturalnessMeter,
    reference: str,
    show: bool = False,
) -> dict[str, NaturalnessMeasure]:
    """Return the naturalness of every kind of a set, by name, from the cache folder; measure and store what is missing.

    reference: hash of the reference set. show: show a progress bar while measuring. A damaged file is measured again. A
    folder that cannot be written is not used.
    """
    vehicles = [source.vehicle(name) for name in source.kinds()]
    hashes = [vehicle_hash(vehicle) for vehicle in vehicles]
    file = cache_file("natural_kinds", source.decoder_hash(), hashes, reference, program_digest(*_CODE))
    if (content := read_cached(file)) is not None:
        return {name: _measure(**values) for name, values in json.loads(content).items()}
    bar = progress_bar(vehicles, desc="measuring how natural each vehicle is", unit="vehicle", disable=not show)
    found = {vehicle.name: measures.of_code(vehicle, decoder, vehicle.latent_code) for vehicle in bar}
    cache_result(
        file, json.dumps({name: asdict(measure) for name, measure in found.items()}).encode()
    )  # floats stay exact
    return found


def _measure(nearest: dict[str, Any] | None, sizes: dict[str, float] | None, **values: Any) -> NaturalnessMeasure:
    if nearest is None or sizes is None:
        return NaturalnessMeasure(None, None, **values)
    directions = {name: tuple(nearest[name]) for name in ("to_member_cm", "from_member_cm")}
    return NaturalnessMeasure(NearestMember(**nearest | directions), Sizes(**sizes), **values)
