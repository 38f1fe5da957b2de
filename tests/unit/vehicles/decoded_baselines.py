"""The five baselines decoded by the shipped decoder: each takes a second, and several files measure them."""

from __future__ import annotations

import functools

import trimesh

from shift3d.sdf.decoder import Decoder, load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles, vehicle_mesh

RESOLUTION = 73


@functools.cache
def _decoder() -> Decoder:
    return load_decoder()


@functools.cache
def decoded_baseline(name: str) -> trimesh.Trimesh:
    """Return the baseline's mesh; tests only read it."""
    return vehicle_mesh(baseline_vehicles()[name], _decoder(), resolution=RESOLUTION)
