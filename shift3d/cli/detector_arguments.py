"""Words for the files of a detector, common to several commands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from shift3d.cli.command import real_number, refuse
from shift3d.detectors.names import FOREIGN, ONNX, OWN
from shift3d.errors import InputError

_FOREIGN_KEYS = ("config", "vehicle_class", "sensor_height_m", "intensity")
DETECTOR_KEYS = ("weights", "module", "file", *_FOREIGN_KEYS)
DETECTOR_HELP = (
    "[weights=FILE] [module=FILE.py] [file=FILE.onnx] [config=FILE [vehicle_class=NAME] [sensor_height_m=M] "
    "[intensity=I]]"
)
"""Help of `DETECTOR_KEYS`."""
# Per detector: the required key with an example value, and the allowed keys. Keys of another detector are refused.
_NEEDED = {OWN: ("module", "FILE.py"), ONNX: ("file", "FILE.onnx"), **dict.fromkeys(FOREIGN, ("config", "FILE"))}
_TAKEN = {OWN: ("weights", "module"), ONNX: ("file",), **dict.fromkeys(FOREIGN, ("weights", *_FOREIGN_KEYS))}


class DetectorFiles(NamedTuple):
    """Files and layout of one detector.

    weights: file of weights or ONNX file; None: the shipped weights, or no weights. module: Python file of the user's
    detector. layout: layout of a detector of another codebase, see `detectors.foreign.layout`.
    """

    weights: str | None
    module: str | None
    layout: dict[str, Any] | None


def detector_files(name: str, values: Mapping[str, str], command: str) -> DetectorFiles:
    """Return the files and layout of a detector from the words of a command.

    Raises: InputError: words of another detector, a missing word or file, an unsupported config, or an invalid number.
    """
    for key in ("module", "file"):
        if key in values and not Path(values[key]).expanduser().is_file():
            raise InputError("no such file", values[key], f"Check {key}=")
    others = [key for key in DETECTOR_KEYS if key not in _TAKEN.get(name, ("weights",))]
    refuse(values, others, f"means nothing for detector={name}", command)
    needed, example = _NEEDED.get(name, ("", ""))
    if needed and not values.get(needed):
        raise InputError(f"{needed}= is missing", command, f"Give {needed}={example}")
    layout = _foreign_layout(name, values, command) if name in FOREIGN else None
    return DetectorFiles(values.get("weights", values.get("file")), values.get("module"), layout)


def detector_name(name: str, values: Mapping[str, str]) -> str:
    """Return the name that tells a detector from others of its kind: the stem of its required file; "" if shipped."""
    needed, _ = _NEEDED.get(name, ("", ""))
    return Path(values[needed]).stem if needed else ""


def _foreign_layout(name: str, values: Mapping[str, str], command: str) -> dict[str, Any]:
    """Read the config of a detector of another codebase."""
    from shift3d.detectors.foreign.config_common import ForeignOverrides
    from shift3d.detectors.foreign.detector import foreign_layout

    numbers = [real_number(values, key, command, "1.7") for key in ("sensor_height_m", "intensity")]
    return foreign_layout(
        name, Path(values["config"]).expanduser(), ForeignOverrides(values.get("vehicle_class"), *numbers)
    )
