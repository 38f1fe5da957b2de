"""Detectors that score a sweep, their files of weights and configs, and their content hashes."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.detectors.names import DETECTOR_NAMES, FOREIGN, GRID_REACH_M, ONNX, OWN
from shift3d.errors import InputError
from shift3d.settings.schema.config import DetectorConfig


def weights_file(name: str, override: str | None) -> Path:
    """Return a detector's file of weights: `override` or the shipped file. Raises: InputError: the file is missing."""
    path = _weights_path(name, override)
    if not path.is_file():
        remedy = "Check the path" if override else f"Give a file of them, or: shift3d train model={name}"
        raise InputError(f"no weights of {name}", where=str(path), remedy=remedy)
    return path


def _weights_path(name: str, override: str | None) -> Path:
    if override:
        return Path(override).expanduser()
    return Path(__file__).resolve().parents[2] / "weights" / f"{name}.safetensors"


def scoring_detectors(config: DetectorConfig) -> dict[str, str | None]:
    """Return the detectors that score every solution, name to weights (None: shipped), the attacked detector first.

    ``scored_by`` names the detectors. With null, every detector with shipped or given weights scores, so that a
    detector without weights stops no sweep that does not name it; ``sst_small`` then scores only if ``sst`` is missing.

    Raises: InputError: weights of a named detector are missing, or a user's files form no detector.
    """
    weights = config.weights_by_name()
    others: list[str] = list(config.scored_by or ())
    if config.scored_by is None:
        others = [name for name in DETECTOR_NAMES if weights.get(name) or _weights_path(name, None).is_file()]
        others = [name for name in others if not (name == "sst_small" and "sst" in others)]
    names = list(dict.fromkeys([config.name, *others]))
    layouts = detector_layouts(config)
    for name in names:
        detector_hash(name, weights.get(name), config.module, layouts.get(name))
    for name in [name for name in names if name == OWN or weights.get(name)]:  # a wrong file fails before any task runs
        from shift3d.detectors.loading import detector_of

        detector_of(name, weights.get(name), config.module, "float32", layouts.get(name))
    return {name: weights.get(name) for name in names}


def detector_layouts(config: DetectorConfig) -> dict[str, dict[str, Any]]:
    """Read the layouts of foreign detectors from their config: detector's name to plain values; {} without a config.

    Raises: InputError naming the config and the missing or unsupported value.
    """
    if config.config is None:
        return {}
    from shift3d.detectors.foreign.config_common import ForeignOverrides
    from shift3d.detectors.foreign.detector import foreign_layout

    choices = ForeignOverrides(config.vehicle_class, config.sensor_height_m, config.intensity)
    names = [name for name in FOREIGN if name in config.named()]
    return {name: foreign_layout(name, Path(config.config).expanduser(), choices) for name in names}


def require_used(configs: Sequence[DetectorConfig], scoring: Sequence[str]) -> None:
    """Refuse weights of a detector that scores nowhere in a sweep. Raises: InputError naming the setting.

    configs: detector settings of every value of the sweep's axes. scoring: every detector that scores somewhere.
    """
    used = {*scoring, *(config.original for config in configs)}
    for config in configs:
        for name, path in config.other_weights.items():
            if path and name not in used:
                remedy = f"Add it: 'detector.scored_by=[{','.join([*(config.scored_by or ()), name])}]'"
                raise InputError(f"other_weights.{name} means nothing: {name} does not score", "detector", remedy)


def detector_hash(name: str, weights: str | None, module: str | None, layout: Mapping[str, Any] | None = None) -> str:
    """Compute the 128-bit BLAKE2b content hash of a detector, hex. Raises: InputError: a file is missing.

    The hash covers the weights or the ONNX file; for the user's detector also the Python file, for a foreign detector
    also the layout from its config.
    """
    if name == ONNX:
        return file_hash(_existing_file(weights or "", "Check detector.file"))
    if name != OWN:
        weights_hash = file_hash(weights_file(name, weights))
        if layout is None:
            return weights_hash
        # Hash the layout, not the config file, so that formatting of the config does not matter.
        text = json.dumps(layout, sort_keys=True, separators=(",", ":")) + weights_hash
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
    remedy = "Check detector.module and detector.weights"
    parts = [_existing_file(part, remedy) for part in (module, weights) if part]
    return hashlib.blake2b("".join(map(file_hash, parts)).encode(), digest_size=16).hexdigest()


def _existing_file(text: str, remedy: str) -> Path:
    path = Path(text).expanduser()
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy=remedy)
    return path


def file_hash(path: Path) -> str:
    """Compute the 128-bit BLAKE2b hash of a file's bytes, hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def require_in_grid(names: Sequence[str], sector_rad: tuple[float, float], range_m: float, shift_m: float) -> None:
    """Refuse places beyond the BEV grid of shipped detectors, where a detector has no cell. Raises: InputError.

    names: detectors that score. sector_rad: (centre, half width) of the placement azimuths. range_m: largest placement
    range. shift_m: largest shift of a vehicle by the search.
    """
    shipped = [name for name in names if name in DETECTOR_NAMES]
    ahead = max(max(abs(math.cos(azimuth)), abs(math.sin(azimuth))) for azimuth in _azimuths(sector_rad))
    if shipped and range_m * ahead + shift_m > GRID_REACH_M:
        moved = f", and moved by {shift_m:g} m" if shift_m else ""
        what = f"vehicles may be put {range_m:g} m away{moved}: {shipped[0]} sees {GRID_REACH_M:.0f} m in x and y"
        remedy = f"Give a smaller attack.placement.max_range_m{' or attack.max_shift_m' if shift_m else ''}"
        raise InputError(what, "attack.placement", remedy)


def require_in_range(
    layouts: Mapping[str, Mapping[str, Any]],
    sector_rad: tuple[float, float],
    ranges_m: tuple[float, float],
    shift_m: float,
) -> None:
    """Refuse foreign detectors whose grid does not cover all reachable places, where they can only miss.

    sector_rad: (centre, half width) of the placement azimuths. ranges_m: least and largest placement range. shift_m:
    largest shift of a vehicle by the search. Raises: InputError naming a place.
    """
    for name, layout in layouts.items():
        grid, turned = layout["grid"], layout["frame"]["turned"]
        high = {axis: grid[f"{axis}_min_m"] + grid["cell_m"] * grid[f"num_{axis}"] for axis in "xy"}
        for azimuth, range_m in itertools.product(_azimuths(sector_rad), ranges_m):
            x, y = range_m * math.cos(azimuth), range_m * math.sin(azimuth)
            there = {"x": -y, "y": x} if turned else {"x": x, "y": y}
            if any(not grid[f"{axis}_min_m"] + shift_m <= there[axis] <= high[axis] - shift_m for axis in "xy"):
                moved, shift = (f" and moved by {shift_m:g} m", ", attack.max_shift_m=") if shift_m else ("", "")
                what = f"vehicles are put at x {x:.0f} m, y {y:.0f} m{moved}, which {name}'s range leaves out"
                remedy = f"Give scenes that it was trained on, as scenes=kitti{shift} or attack.placement.max_range_m="
                raise InputError(what, "detector.config", remedy)


def _azimuths(sector_rad: tuple[float, float]) -> list[float]:
    centre, half_width = sector_rad
    return [centre + half_width * step / 32 for step in range(-32, 33)]
