"""The words that describe a detector of another codebase, which several commands take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shift3d.detectors.names import FOREIGN
from shift3d.errors import InputError

FOREIGN_KEYS = ("config", "vehicle_class", "sensor_height_m", "intensity")


def foreign_layout_of(name: str, values: Mapping[str, str], command: str) -> dict[str, Any] | None:
    """What the config of a detector of another codebase says; None for any other detector.

    Raises: InputError for words that do not belong to the detector, a config that is missing or not covered, or a value
        that is no number.
    """
    if name not in FOREIGN:
        for key in FOREIGN_KEYS:
            if key in values:
                raise InputError(f"{key}= means nothing for detector={name}", command, f"Leave out {key}=")
        return None
    if not values.get("config"):
        raise InputError("config= is missing", command, f"Give config=FILE, the model's config of {name}")
    from shift3d.detectors.foreign.detector import foreign_layout
    from shift3d.detectors.foreign.parts import Choices

    numbers = [_number(values, key, command) for key in ("sensor_height_m", "intensity")]
    return foreign_layout(name, Path(values["config"]).expanduser(), Choices(values.get("vehicle_class"), *numbers))


def _number(values: Mapping[str, str], key: str, command: str) -> float | None:
    text = values.get(key)
    try:
        value = None if text is None else float(text)
    except ValueError:
        value = math.nan
    if value is not None and not math.isfinite(value):
        raise InputError(f"{key}={text!r} is not a number", command, f"Give {key}=1.7")
    return value
