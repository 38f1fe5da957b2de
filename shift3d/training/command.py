"""What ``shift3d train`` and ``shift3d evaluate`` do: train the shipped weights again, and say how good they are."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shift3d.errors import InputError

if TYPE_CHECKING:
    from shift3d.training.detector_evaluation import EvaluationRules

__all__ = ["MODELS", "evaluate", "train"]

MODELS = ("sdf", "pointpillars", "sst")
WEIGHTS_FOLDER = Path(__file__).resolve().parents[1] / "weights"


def train(model: str, out: Path, threads: int | None = None) -> int:
    """Train a shipped model from nothing but this package, or go on where an interrupted training stopped.

    Args:
        model: one of MODELS; the detectors need the weights of sdf, whose vehicles they are trained on.
        out: holds samples, scenes and checkpoints; the finished weights go to ``shift3d/weights``.
        threads: of the arithmetic; default every core.

    Raises:
        InputError: unknown model; a checkpoint of another recipe in ``out``.
    """
    threads = threads or os.cpu_count() or 1
    trainers: dict[str, Callable[[Path, int], None]] = {
        "sdf": _train_sdf,
        "pointpillars": partial(_train_detector, "pointpillars"),
        "sst": partial(_train_detector, "sst"),
    }
    start = time.monotonic()
    _known(model, trainers)(out, threads)
    print(f"{model}: trained in {(time.monotonic() - start) / 60:.0f} min, weights in {WEIGHTS_FOLDER.name}/")
    return 0


def evaluate(model: str, kitti: str | None = None, scenes: int = 200) -> int:
    """Print how good a shipped model is.

    pointpillars: average precision on ``scenes`` held-out procedural scenes and, given ``kitti``, the folder that
    holds training/, on its labelled frames. sdf: Chamfer distance to vehicles of the training family and to unseen
    ones.

    Raises:
        InputError: unknown model, missing weights or frames.
    """
    evaluators: dict[str, Callable[[str | None, int], None]] = {
        "sdf": _evaluate_sdf,
        "pointpillars": _evaluate_pointpillars,
    }
    _known(model, evaluators)(kitti, scenes)
    return 0


def _known(model: str, table: dict[str, Callable[..., None]]) -> Callable[..., None]:
    if model not in table:
        raise InputError(f"unknown model {model!r}", "model=", f"Choose from {', '.join(MODELS)}")
    return table[model]


def _train_sdf(out: Path, threads: int) -> None:
    from shift3d.training.sdf import train_sdf
    from shift3d.training.sdf_export import export_sdf

    export_sdf(train_sdf(out, threads=threads), WEIGHTS_FOLDER)


def _train_detector(name: str, out: Path, threads: int) -> None:
    from shift3d.training.detector import RECIPES, train_detector

    train_detector(out, RECIPES[name], threads=threads, weights_file=WEIGHTS_FOLDER / f"{name}.safetensors")


def _evaluate_sdf(kitti: str | None, scenes: int) -> None:
    from shift3d.sdf.decoder import load_decoder
    from shift3d.vehicles.fidelity import training_chamfer_m, unseen_chamfer_m

    del kitti, scenes  # a shape model sees no scene
    decoder = load_decoder()
    for name, measure in (("training vehicles", training_chamfer_m), ("unseen, auto-decoded", unseen_chamfer_m)):
        metres = measure(decoder, 27)  # three of each body type
        print(
            f"sdf, {name}: Chamfer distance (mean of both directions), median {100 * np.median(metres):.2f} cm, "
            f"worst {100 * metres.max():.2f} cm, {len(metres)} vehicles",
            flush=True,
        )


def _evaluate_pointpillars(kitti: str | None, scenes: int) -> None:
    from shift3d.detectors.weights import load_detector
    from shift3d.training.detector_evaluation import EvaluationRules, evaluate_kitti, evaluate_street

    detector = load_detector("pointpillars")
    rules = EvaluationRules()
    street = evaluate_street(detector, scenes, rules=rules)
    print(
        f"pointpillars, {street.scenes} held-out street scenes: {_describe(rules)} {street.average_precision.value:.3f}"
    )
    if kitti is not None:
        rules = EvaluationRules(iou_threshold=0.5)
        real = evaluate_kitti(detector, Path(kitti).expanduser(), rules)
        print(
            f"pointpillars, {real.scenes} KITTI frames, cars in view: {_describe(rules)} "
            f"{real.average_precision.value:.3f}"
        )


def _describe(rules: EvaluationRules) -> str:
    return (
        f"BEV AP at IoU {rules.iou_threshold:g} of vehicles within {rules.max_range_m:g} m "
        f"with at least {rules.min_points} points"
    )
