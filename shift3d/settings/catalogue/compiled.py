"""Detectors without a gradient; comparison of ONNX files with the detectors that they were exported from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.attack.names import GRADIENT_FREE, OVER_KINDS
from shift3d.detectors.names import ONNX, OWN
from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.settings.catalogue.detector_files import detector_layouts
from shift3d.settings.schema.config import Config, DetectorConfig
from shift3d.wording import counted

if TYPE_CHECKING:
    from torch import Tensor
    from tqdm import tqdm

    from shift3d.scenes.sets import SceneSet

_COMPARED_SCENES = 3
_done: dict[str, str] = {}


def refuse_gradient_search(config: Config) -> None:
    """Refuse a gradient search on an ONNX file or a user's detector that returns scores. Raises: InputError."""
    search, detector = config.attack.search, config.detector
    if search in GRADIENT_FREE:
        return
    if detector.name == ONNX or (detector.name == OWN and _returns_scores_only(detector)):
        what = "an ONNX file" if detector.name == ONNX else f"{detector.module} (numpy arrays)"
        what = f"attack.search={search} follows a gradient, and {what} gives none"
        fitting = [name for name in GRADIENT_FREE if config.attack.space != "family" or name in OVER_KINDS]
        remedy = f"Give attack.search={', or '.join(fitting)}"
        raise InputError(what, f"detector={detector.name}", remedy)


def _returns_scores_only(config: DetectorConfig) -> bool:
    from shift3d.detectors.loading import detector_of
    from shift3d.detectors.scores_only import ScoresOnlyDetector

    return isinstance(detector_of(OWN, config.own_weights, config.module, "float32"), ScoresOnlyDetector)


def compare_with_original(config: DetectorConfig, scenes: SceneSet, names: Sequence[str]) -> str:
    """Compare an ONNX file with its original detector; return the result in one line.

    The process caches the result per file, original and scenes. Without an original, nothing is compared.
    names: names of a sweep's scenes; the comparison uses the first three.

    Raises: InputError: scores differ by more than 1e-3 (see `check_score_agreement`), or no loadable original.
    """
    if config.original is None:
        return f"{config.file}: scores are compared with no original, as detector.original names none"
    first = tuple(islice(names, _COMPARED_SCENES))
    weights, layout = config.weights_by_name(), detector_layouts(config).get(config.original)
    where = [scenes.source(name) for name in first]  # frames of two folders may have one name
    key = repr((config.file, config.original, weights.get(config.original), config.module, layout, where))
    if key not in _done:
        from shift3d.detectors.compiled.agreement import check_score_agreement
        from shift3d.detectors.loading import detector_of

        compiled = detector_of(ONNX, config.file, None, "float32")
        original = detector_of(config.original, weights.get(config.original), config.module, "float32", layout)
        with progress_bar(total=len(first), desc=f"comparing with {config.original}", unit="scene", delay=1.0) as bar:
            worst = check_score_agreement(original, compiled, _clouds(scenes, first, bar), str(config.file))
        _done[key] = (
            f"{config.file}: scores are those of {config.original} within {worst.difference:.1g} "
            f"in {counted(len(first), 'scene')}"
        )
    return _done[key]


def export_onnx_detector(name: str, weights: str | None) -> tuple[bytes, float]:
    """Export a detector of shift3d; return the bytes of the ONNX file and the largest score difference on two streets.

    weights: a file; None: the shipped weights. Raises: InputError: unreadable weights, a network without an export,
        missing packages, or scores that differ by more than 1e-3.
    """
    from shift3d.detectors.compiled.agreement import check_score_agreement
    from shift3d.detectors.compiled.onnx_detector import onnx_detector
    from shift3d.detectors.compiled.onnx_export import onnx_bytes
    from shift3d.detectors.loading import load_detector
    from shift3d.detectors.models.weights import WEIGHTS_FOLDER, load_network
    from shift3d.scenes.sets import StreetScenes

    original = load_detector(name, weights)
    file = Path(weights or WEIGHTS_FOLDER / f"{name}.safetensors").expanduser()
    streets, where = StreetScenes("mixed", count=2), f"{name} as ONNX"
    with progress_bar(total=1 + streets.count, desc=f"exporting {name}", unit="step") as bar:
        content = onnx_bytes(load_network(file, name))
        bar.update()
        bar.set_description(f"comparing with {name}")
        compiled = onnx_detector(content, where)
        worst = check_score_agreement(original, compiled, _clouds(streets, streets.names(), bar), where)
    return content, worst.difference


def _clouds(scenes: SceneSet, names: Sequence[str], bar: tqdm[Any]) -> Iterator[tuple[str, Tensor]]:
    """Yield name and points (N, 3), network frame, of each scene; count it in `bar` when the next one is requested."""
    import torch

    from shift3d.attack.objective import to_network_frame

    for name in names:
        scene = scenes.load(name)
        yield name, to_network_frame(torch.from_numpy(scene.points), scene.ground_z_m)
        bar.update()
