"""Evaluation of a detector, written to a folder: detections, ground truth, metrics, curves, tables and a figure."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import shift3d
from shift3d.analysis.figures.picture import png
from shift3d.analysis.tables.detector_tables import (
    breakdown_tables,
    evaluation_tables,
    group_table,
    metric_table,
    summary_table,
)
from shift3d.analysis.tables.table import number
from shift3d.detectors.base import Detector
from shift3d.detectors.loading import detector_of, runtime_of
from shift3d.detectors.models.weights import WEIGHTS_FOLDER
from shift3d.detectors.names import DETECTOR_NAMES, ONNX, OWN
from shift3d.errors import InputError
from shift3d.evaluation.breakdown import breakdown
from shift3d.evaluation.metrics import RANGES_M, Metric, evaluate
from shift3d.progress_bar import progress_bar
from shift3d.scenes.sets import SceneSet
from shift3d.settings.catalogue.detector_files import file_hash
from shift3d.settings.schema.scenes import FramesConfig, KittiConfig, OpenPcdetConfig, StreetConfig, scene_set
from shift3d.store.atomic import write_atomic
from shift3d.store.evaluation_tables import EVALUATION_SCHEMA_VERSION
from shift3d.store.tables import write_table
from shift3d.store.user_cache import program_digest
from shift3d.training.detector.detect_scenes import SCORE_FLOOR, SceneDetections, detect_scenes, stored_or_detected
from shift3d.training.provenance import refuse_tuned_scenes, trained_frames
from shift3d.wording import counted

_CODE = (
    *("scenes", "vehicles", "sdf", "geometry", "seeding.py", "detectors"),
    *("training/detector_scenes.py", "training/detector/detect_scenes.py"),
)


def precision_recall_figure(metrics: Sequence[Metric], title: str) -> Figure:
    """Draw Waymo's precision-recall curves, 0-75 m: bird's-eye view and 3D, both levels, both IoU thresholds."""
    figure = Figure(figsize=(8, 3.8), dpi=110, layout="constrained")
    axes = dict(zip(("BEV", "3D"), figure.subplots(1, 2, sharey=True)))
    colours, widths = {"LEVEL_1": "#c03030", "LEVEL_2": "#4878a8"}, {"LEVEL_1": 3.0, "LEVEL_2": 1.0}
    for metric in metrics:
        if metric.protocol != "waymo" or (metric.min_range_m, metric.max_range_m) != RANGES_M[0]:
            continue
        label = f"{metric.subset}, IoU {metric.iou_threshold:g}: {number(metric.curve.average_precision)}"
        axes[metric.view].plot(
            metric.curve.recall,
            metric.curve.precision,
            color=colours[metric.subset],
            linestyle="-" if metric.iou_threshold == 0.7 else ":",
            linewidth=widths[metric.subset],  # two widths: both lines show where the levels coincide
            label=label,
        )
    for view, panel in axes.items():
        panel.set(title=view, xlabel="recall", xlim=(0, 1.02), ylim=(0, 1.02))
        panel.legend(fontsize=7, loc="lower left", frameon=False)
    axes["BEV"].set_ylabel("precision")
    figure.suptitle(title, fontsize=9)
    return figure


EvaluatedScenes = StreetConfig | KittiConfig | OpenPcdetConfig
"""Scenes in which a detector can be evaluated: intervals resample frames, so frames must be independent."""


def dataset_of(scenes: EvaluatedScenes) -> str:
    """Return the name of the evaluated scenes, as used in the tables and in the folder's name."""
    if isinstance(scenes, FramesConfig):
        return scenes.kind
    traffic = f"-{scenes.traffic}" if scenes.traffic != "family" else ""
    return f"street-{scenes.sensor}-{scenes.split}{traffic}"


def _identity(scenes: EvaluatedScenes) -> dict[str, object]:
    """Return the settings that decide which scene a scene name refers to."""
    if isinstance(scenes, FramesConfig):
        deciding = {"split", "sensor_m", "ground_z_m", "reflectance_max"}
        settings = scenes.model_dump(mode="json", include=deciding, exclude_none=True)
        return {"root": str(Path(scenes.root).expanduser().resolve()), **settings}
    traffic = {"traffic": scenes.traffic} if scenes.traffic != "family" else {}
    return {"sensor": scenes.sensor, "split": scenes.split, "seed": scenes.seed, **traffic}


def evaluate_detector(
    name: str,
    scenes: EvaluatedScenes,
    out: Path,
    weights: str | None = None,
    module: str | None = None,
    layout: Mapping[str, Any] | None = None,
    workers: int = 1,
    score_threshold: float = SCORE_FLOOR,
) -> str:
    """Detect in every scene, write the folder ``out``, and return the text to print.

    ``out`` gets spec.json, detections.parquet, truth.parquet, vehicles.parquet, metrics.parquet, breakdown.parquet,
    curves.parquet and curves.png, whose bytes do not depend on the number of workers, and timings.parquet, which
    differs from run to run. ``out``/scenes holds the answer for each scene. A repeated call detects only in scenes
    whose answer is missing, or whose source files, program code or libraries have changed since.

    Args:
        name: detector; it uses its shipped weights or those of the file ``weights``, which may be an ONNX file.
        module: Python file of the user's own detector.
        layout: layout of a detector of another codebase, see `detectors.foreign.layout`.
        workers: number of processes, with one thread each.
        score_threshold: detections with a lower score are dropped.

    Raises: InputError: unknown detector, missing weights or scenes, weights that were fine-tuned on one of the scenes,
    another evaluation in ``out``, a full disk.
    """
    file = Path(weights).expanduser() if weights else None
    if file is None and name in DETECTOR_NAMES:
        file = WEIGHTS_FOLDER / f"{name}.safetensors"
    opened: Callable[[], Detector] = partial(detector_of, name, file, module, "float32", layout)
    opened()  # a faulty detector raises before anything is computed
    spec: dict[str, object] = {
        "schema_version": EVALUATION_SCHEMA_VERSION,
        "shift3d": shift3d.__version__,
        "detector": name,
        "weights_blake2b": file_hash(file) if file else None,
        "dataset": dataset_of(scenes),
        "scenes": _identity(scenes),
        "score_threshold": score_threshold,
        **({"module_blake2b": file_hash(Path(module).expanduser())} if module else {}),
        **({"layout": layout} if layout else {}),
    }
    open_scenes = partial(scene_set, scenes)
    opened_scenes = open_scenes()
    scene_names = opened_scenes.names()
    seen: list[str] = []
    if file and name not in (OWN, ONNX):  # files beside own and ONNX weights belong to the user
        measured = [(opened_scenes.dataset, scene, "") for scene in scene_names]
        refuse_tuned_scenes(file, measured)
        seen = trained_frames(file, measured)
    _claim(out / "spec.json", spec)
    detect = partial(detect_scenes, opened, open_scenes, workers, score_threshold)
    found = stored_or_detected(scene_names, out / "scenes", detect, partial(_state, opened_scenes, name))
    label = f"{name}, {counted(workers, 'worker')}"
    answers = list(progress_bar(found, desc=label, total=len(scene_names), unit="scene", smoothing=0.1))
    text = write_evaluation(name, dataset_of(scenes), answers, out)
    if not seen:
        return text
    of = f"{len(seen)} of these {counted(len(scene_names), 'scene')}"
    same = "If they are the same frames, expect a lower AP on other scenes"
    return f"{text}\nwarning: {file} was trained on frames with the names of {of}. {same}"


def _state(scenes: SceneSet, detector: str, name: str) -> str:
    """Return a digest of a recorded frame's files and of the program; a stored answer is valid for one digest."""
    text = json.dumps([program_digest(*_CODE, runtime=runtime_of(detector)), *scenes.source(name)])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def write_evaluation(detector: str, dataset: str, answers: Sequence[SceneDetections], out: Path) -> str:
    """Compute every metric of the answers, write tables and figure to ``out``, and return the text to print.

    Raises: InputError: the disk is full or not writable.
    """
    frames = [answer.frame for answer in answers]
    metrics = list(evaluate(frames))
    vehicles, groups = breakdown(frames)
    tables = evaluation_tables(detector, dataset, answers, metrics)
    tables |= breakdown_tables(detector, dataset, frames, vehicles, groups)
    for name, table in tables.items():
        write_table(out / f"{name}.parquet", table)
    figure = precision_recall_figure(metrics, f"{detector} on {dataset}, {counted(len(answers), 'scene')}")
    write_atomic(out / "curves.png", png(figure))
    took = np.median([answer.detect_ms for answer in answers])
    title = f"{detector} on {dataset}: {counted(len(answers), 'scene')}, {took:.0f} ms per scene (median, one thread)"
    printed: list[object] = [
        summary_table(title, groups),
        group_table(groups),
        metric_table("AP by every definition", metrics),
    ]
    if not any(len(frame.truth.boxes) for frame in frames):
        printed.append("No scene has a labelled vehicle. shift3d scenes show prints the labels that shift3d reads.")
    return (
        "\n\n".join(map(str, printed)) + f"\n{out} holds every number, curve, vehicle, detection and label as Parquet"
    )


def _claim(file: Path, spec: dict[str, object]) -> None:
    """Write the spec of the evaluation, or refuse a folder that holds another evaluation."""
    content = json.dumps(spec, indent=1).encode() + b"\n"
    if file.exists() and file.read_bytes() != content:
        raise InputError("holds another evaluation", str(file.parent), "Give another out=DIR, or remove the folder")
    write_atomic(file, content)
