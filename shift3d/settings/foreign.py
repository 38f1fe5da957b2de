"""Detectors of other codebases among the settings: their configs read, their content hashed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.detectors.names import FOREIGN

if TYPE_CHECKING:
    from shift3d.settings.schema import DetectorConfig

__all__ = ["detector_layouts", "layout_hash"]


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
