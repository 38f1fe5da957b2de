"""What ``shift3d train`` and ``shift3d evaluate`` do: train the shipped weights again, and say how good they are."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from shift3d.errors import InputError

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


def evaluate(model: str) -> int:
    """Print how good the shipped shape model is: Chamfer distance to vehicles it was trained on and to unseen ones.

    Detectors have :func:`shift3d.report.evaluation.evaluate_detector`.

    Raises:
        InputError: another model, or missing weights.
    """
    if model != "sdf":
        remedy = f"Give model=sdf, or detector={model} scenes=street" if model in MODELS else "Give model=sdf"
        raise InputError(f"model={model} is no shape model", "evaluate", remedy)
    _evaluate_sdf()
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


def _evaluate_sdf() -> None:
    from shift3d.sdf.decoder import load_decoder
    from shift3d.vehicles.fidelity import training_chamfer_m, unseen_chamfer_m

    decoder = load_decoder()
    for name, measure in (("training vehicles", training_chamfer_m), ("unseen, auto-decoded", unseen_chamfer_m)):
        metres = measure(decoder, 27)  # three of each body type
        print(
            f"sdf, {name}: Chamfer distance (mean of both directions), median {100 * np.median(metres):.2f} cm, "
            f"worst {100 * metres.max():.2f} cm, {len(metres)} vehicles",
            flush=True,
        )
