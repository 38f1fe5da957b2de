"""Which detectors score a sweep, their files of weights and configs, and the hashes of what they are made of."""

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
    """A detector's file of weights: the one given, or the one that ships. Raises InputError where it is missing."""
    path = _weights_path(name, override)
    if not path.is_file():
        remedy = "Check the path" if override else f'Give a file of them, or: make train ARGS="model={name}"'
        raise InputError(f"no weights of {name}", where=str(path), remedy=remedy)
    return path


def _weights_path(name: str, override: str | None) -> Path:
    if override:
        return Path(override).expanduser()
    return Path(__file__).resolve().parents[2] / "weights" / f"{name}.safetensors"


def scoring_detectors(config: DetectorConfig) -> dict[str, str | None]:
    """Detectors that score every solution, name to weights (None: those that ship), the attacked one first.

    Those that ``scored_by`` names; where it is null, those whose weights ship or are given, so that a detector
    without weights stops nobody who did not ask for it. The small SST stands in for the published one then: where both
    are there, it scores only what it is asked to.

    Raises: InputError: weights of a detector that was asked for are missing, or a user's files are no detector.
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
    for name in [name for name in names if name == OWN or weights.get(name)]:  # said before anything runs
        from shift3d.detectors.loading import detector_of

        detector_of(name, weights.get(name), config.module, "float32", layouts.get(name))
    return {name: weights.get(name) for name in names}


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


def require_used(configs: Sequence[DetectorConfig], scoring: Sequence[str]) -> None:
    """Refuse weights of a detector that scores nowhere in a sweep.

    configs: what its values of an axis ask for. scoring: every detector that scores somewhere.
    Raises: InputError naming the setting.
    """
    used = {*scoring, *(config.original for config in configs)}
    for config in configs:
        for name, path in config.other_weights.items():
            if path and name not in used:
                remedy = f"Add it: 'detector.scored_by=[{','.join([*(config.scored_by or ()), name])}]'"
                raise InputError(f"other_weights.{name} means nothing: {name} does not score", "detector", remedy)


def detector_hash(name: str, weights: str | None, module: str | None, layout: Mapping[str, Any] | None = None) -> str:
    """128-bit BLAKE2b of what a detector is made of, hex.

    Its weights, or its ONNX file; of the user's own, its Python file with its weights; of a foreign one, the layout
    that its config describes with its weights.

    Raises: InputError: a file is missing.
    """
    if name == ONNX:
        return file_hash(_existing_file(weights or "", "Check detector.file"))
    if name != OWN:
        weights_hash = file_hash(weights_file(name, weights))
        if layout is None:
            return weights_hash
        # The same however its config is written.
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
    """128-bit BLAKE2b of a file's bytes, hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def require_in_grid(names: Sequence[str], sector_rad: tuple[float, float], range_m: float, shift_m: float) -> None:
    """Refuse places beyond the grid of shipped detectors, where a task would find no cell to look at.

    names: of the detectors that score. sector_rad: (centre, half width) of the azimuths of places. range_m: how far
    away they lie at most. shift_m: how far a search may move a vehicle from its place.

    Raises: InputError naming the settings.
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
    """Refuse foreign detectors whose grid leaves out places where vehicles are put or moved to: there they could only
    miss.

    sector_rad: (centre, half width) of the azimuths of places. ranges_m: how far away they lie, least and most.
    shift_m: how far a search may move a vehicle from its place.

    Raises: InputError naming a place.
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
