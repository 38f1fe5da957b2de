"""Loading of detectors by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shift3d.detectors.base import Detector
from shift3d.detectors.models.network import Precision
from shift3d.detectors.models.weights import NETWORKS, WEIGHTS_FOLDER, load_network
from shift3d.detectors.names import DETECTOR_NAMES, FOREIGN, ONNX, OWN
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError


def load_detector(
    name: str = "pointpillars", path: Path | str | None = None, precision: Precision = "float32"
) -> TrainedDetector:
    """Load a detector of shift3d, weights shipped or from `path`. Raises: InputError: unknown name, bad weights."""
    if name not in NETWORKS:
        remedy = f"One of: {', '.join([*DETECTOR_NAMES, *FOREIGN, OWN, ONNX])}"
        raise InputError(f"unknown detector {name!r}", where="detector", remedy=remedy)
    file = Path(path).expanduser() if path is not None else WEIGHTS_FOLDER / f"{name}.safetensors"
    return TrainedDetector(load_network(file, name), precision)


def detector_of(
    name: str,
    path: Path | str | None,
    module: Path | str | None,
    precision: Precision,
    layout: Mapping[str, Any] | None = None,
) -> Detector:
    """Load a detector of shift3d, the user's own from a Python file, an ONNX file, or one of another codebase.

    path: weights (None: the shipped weights, or no weights), or an ONNX file, which ignores `precision`.
    module: Python file of the user's own detector. layout: of a foreign detector, see `foreign.layout`.

    Raises: InputError as `load_detector`, `load_user_detector`, `load_onnx` and `load_foreign` do, or if a required
        file or config is not given.
    """
    if name in FOREIGN:
        if path is None or layout is None:
            remedy = "Give detector.weights=FILE.pth and detector.config=FILE"
            raise InputError(f"a detector of {name} needs weights and a config", where="detector", remedy=remedy)
        from shift3d.detectors.foreign.detector import load_foreign

        return load_foreign(layout, Path(path).expanduser(), precision)
    if name == ONNX:
        if path is None:
            raise InputError("an ONNX detector needs a file", where="detector", remedy="Give detector.file=FILE.onnx")
        from shift3d.detectors.compiled.onnx_detector import load_onnx

        return load_onnx(Path(path).expanduser())
    if name != OWN:
        return load_detector(name, path, precision)
    if module is None:
        raise InputError("your own detector needs a file", where="detector", remedy="Give detector.module=FILE.py")
    from shift3d.detectors.user_detector import load_user_detector

    return load_user_detector(Path(module).expanduser(), None if path is None else Path(path).expanduser(), precision)


def runtime_of(name: str) -> str:
    """Return the library with its version that computes a detector's scores, for cache keys; "" if torch does.

    The packages of the detector must be installed.
    """
    if name != ONNX:
        return ""
    import onnxruntime

    return f"onnxruntime {onnxruntime.__version__}"
