"""Detectors of other codebases among the settings: their configs read, their content hashed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.detectors.names import FOREIGN
from shift3d.errors import InputError

if TYPE_CHECKING:
    from shift3d.settings.schema.config import DetectorConfig


def detector_layouts(config: DetectorConfig) -> dict[str, dict[str, Any]]:
    """What the config of a foreign detector says, by the detector's name, as plain values; nothing where none is asked.

    Raises: InputError naming the config, and the value that is missing or not covered.
    """
    if config.config is None:
        return {}
    from shift3d.detectors.foreign.detector import foreign_layout
    from shift3d.detectors.foreign.parts import Choices

    choices = Choices(config.vehicle_class, config.sensor_height_m, config.intensity)
    names = [name for name in FOREIGN if name in config.named()]
    return {name: foreign_layout(name, Path(config.config).expanduser(), choices) for name in names}


def layout_hash(layout: Mapping[str, Any], weights_hash: str) -> str:
    """128-bit BLAKE2b of a layout with its weights, hex: the same however its config is written."""
    text = json.dumps(layout, sort_keys=True, separators=(",", ":")) + weights_hash
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def require_in_range(layouts: Mapping[str, Mapping[str, Any]], sector_rad: tuple[float, float], range_m: float) -> None:
    """Refuse foreign detectors whose grid leaves out places where vehicles are put: there they could only miss.

    sector_rad: (centre, half width) of the azimuths of places. range_m: how far away they lie at most.

    Raises: InputError naming a place.
    """
    centre, half_width = sector_rad
    azimuths = [centre + half_width * step / 32 for step in range(-32, 33)]
    for name, layout in layouts.items():
        grid, turned = layout["grid"], layout["frame"]["turned"]
        high = {axis: grid[f"{axis}_min_m"] + grid["cell_m"] * grid[f"num_{axis}"] for axis in "xy"}
        for azimuth in azimuths:
            x, y = range_m * math.cos(azimuth), range_m * math.sin(azimuth)
            there = {"x": -y, "y": x} if turned else {"x": x, "y": y}
            if any(not grid[f"{axis}_min_m"] <= there[axis] <= high[axis] for axis in "xy"):
                what = f"vehicles are put at x {x:.0f} m, y {y:.0f} m, which {name}'s range leaves out"
                remedy = "Give scenes that it was trained on, as scenes=kitti, or attack.placement.max_range_m="
                raise InputError(what, "detector.config", remedy)
