"""Trained detectors by name."""

from __future__ import annotations

from pathlib import Path

from shift3d.detectors.models.network import Precision
from shift3d.detectors.models.weights import NETWORKS, WEIGHTS_FOLDER, load_network
from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError

__all__ = ["load_detector"]


def load_detector(
    name: str = "pointpillars", path: Path | str | None = None, precision: Precision = "float32"
) -> TrainedDetector:
    """A detector by name with the shipped weights, or those of `path`.

    Raises: InputError for an unknown name or bad weights.
    """
    if name not in NETWORKS:
        raise InputError(f"unknown detector {name!r}", where="detector", remedy=f"known: {', '.join(DETECTOR_NAMES)}")
    file = Path(path) if path is not None else WEIGHTS_FOLDER / f"{name}.safetensors"
    return TrainedDetector(load_network(file, name), precision)
