"""The words that say what a detector is made of, which several commands take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from shift3d.detectors.names import FOREIGN, ONNX, OWN
from shift3d.errors import InputError

_FOREIGN_KEYS = ("config", "vehicle_class", "sensor_height_m", "intensity")
DETECTOR_KEYS = ("weights", "module", "file", *_FOREIGN_KEYS)


class DetectorFiles(NamedTuple):
    """weights: a file, an ONNX file too; None: those that ship, or none. module: Python file of the user's own. layout:
    of one of another codebase, see `detectors.foreign.layout`."""

    weights: str | None
    module: str | None
    layout: dict[str, Any] | None


def detector_files(name: str, values: Mapping[str, str], command: str) -> DetectorFiles:
    """What the words of a command say of a detector.

    Raises: InputError for words that do not belong to the detector, one that is missing, a file that is missing, a
        config that is not covered, or a value that is no number.
    """
    for key in ("module", "file"):
        if key in values and not Path(values[key]).expanduser().is_file():
            raise InputError("no such file", values[key], f"Check {key}=")
    for key, of in (("module", OWN), ("file", ONNX)):
        if key in values and name != of:
            raise InputError(f"{key}= means nothing for detector={name}", command, f"Leave out {key}=")
        if key not in values and name == of:
            raise InputError(f"{key}= is missing", command, f"Give {key}=FILE.{'py' if key == 'module' else 'onnx'}")
    if name == ONNX and "weights" in values:
        raise InputError(f"weights= means nothing for detector={name}", command, "Leave out weights=: file= holds them")
    layout = foreign_layout_of(name, values, command)
    return DetectorFiles(values.get("weights", values.get("file")), values.get("module"), layout)


def foreign_layout_of(name: str, values: Mapping[str, str], command: str) -> dict[str, Any] | None:
    """What the config of a detector of another codebase says; None for any other detector.

    Raises: InputError for words that do not belong to the detector, a config that is missing or not covered, or a value
        that is no number.
    """
    if name not in FOREIGN:
        for key in _FOREIGN_KEYS:
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
