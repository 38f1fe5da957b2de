"""Tables of a detector's evaluation: printed tables (metrics, groups of vehicles) and the files of its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pyarrow as pa

from shift3d.analysis.tables.table import Table, number
from shift3d.evaluation.breakdown import BreakdownRow
from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth
from shift3d.evaluation.metrics import RANGES_M, Metric
from shift3d.evaluation.vehicles import ERRORS, VehicleRows
from shift3d.store.evaluation_tables import evaluation_table
from shift3d.training.detector.detect_scenes import SceneDetections

_MEASURES = (
    ("AP", "BEV", "BEV AP"),
    ("APH", "BEV", "BEV APH"),
    ("AP", "3D", "3D AP"),
    ("APH", "3D", "3D APH"),
    ("recall", "BEV 0.7", "recall, BEV"),
    ("recall", "3D 0.7", "recall, 3D"),
    ("flips", "share", "flipped"),
)
_ERRORS = {
    "x_m": "along, m",
    "y_m": "across, m",
    "z_m": "height of centre, m",
    "dx_m": "length, m",
    "dy_m": "width, m",
    "dz_m": "height, m",
    "heading_rad": "heading, rad",
}


def summary_table(title: str, rows: Sequence[BreakdownRow]) -> Table:
    """Build the summary over LEVEL_1 vehicles, 0-75 m, IoU 0.7: AP, APH, recall, flips, errors with 95 % intervals."""
    known = {(row.measure, row.statistic): row for row in rows if row.by == "all"}
    lines = []
    for measure, statistic, name in _MEASURES:
        row = known[measure, statistic]
        lines.append([name, number(row.value), _interval(row), "", "", str(row.number)])
    for error, name in _ERRORS.items():
        mean, middle, spread = (known[f"error_{error}", statistic] for statistic in ("mean", "median", "std"))
        others = [number(middle.value), number(spread.value), str(mean.number)]
        lines.append([name, number(mean.value), _interval(mean), *others])
    note = "LEVEL_1, 0-75 m, IoU 0.7; errors are means of detected minus true; intervals: 95 %, scenes resampled"
    return Table(f"{title}\n{note}", ["", "value", "interval", "median", "std", "number"], lines)


def group_table(rows: Sequence[BreakdownRow]) -> Table:
    """Build the table by group: range, heading, number of points, and kind of vehicle if the labels have one."""
    known = {(row.by, row.group, row.measure, row.statistic): row for row in rows}
    lines = []
    for by, group in dict.fromkeys((row.by, row.group) for row in rows if row.by != "all"):
        line = [f"{by}: {group}", str(known[by, group, "AP", "BEV"].number)]
        for view in ("BEV", "3D"):
            row = known[by, group, "AP", view]
            line += [number(row.value), _interval(row)]
        others = (("recall", "BEV 0.7"), ("flips", "share"), *((f"error_{e}", "mean") for e in ("z_m", "dx_m", "dz_m")))
        lines.append([*line, *(number(known[by, group, *key].value) for key in others)])
    header = ["", "number", "BEV AP", "interval", "3D AP", "interval", "recall", "flipped"]
    return Table("By group, as above", [*header, "z m", "length m", "height m"], lines)


def _interval(row: BreakdownRow) -> str:
    return "-" if row.low is None or row.high is None else f"{row.low:.3f} to {row.high:.3f}"


_PROTOCOLS = {
    "waymo": "Waymo",
    "waymo_strict": "Waymo, strict",
    "kitti": "KITTI, 40 recalls",
    "shift3d": "exact area",
}


def metric_table(title: str, metrics: Sequence[Metric]) -> Table:
    """Build the table of AP and APH in both views, one line per definition, IoU threshold, subset and range.

    Omitted but in metrics.parquet: Waymo's range bins at IoU 0.5, and its strict counting except for 0-75 m.
    """
    lines: dict[tuple[object, ...], dict[str, Metric]] = {}
    for metric in metrics:
        key = (metric.protocol, metric.iou_threshold, metric.subset, metric.min_range_m, metric.max_range_m)
        if not _left_out(metric):
            lines.setdefault(key, {})[metric.view] = metric
    # Sorted by definition, IoU 0.7 before 0.5.
    ordered = sorted(lines.items(), key=lambda item: (list(_PROTOCOLS).index(str(item[0][0])), -float(str(item[0][1]))))
    cells = []
    for (protocol, iou_threshold, subset, low, high), views in ordered:
        values = []
        for view in ("BEV", "3D"):
            curve = views[view].curve
            values += [number(curve.average_precision), number(curve.average_precision_heading)]
        region = "any" if high is None else f"{low:g}-{high:g}"
        count = str(views["BEV"].curve.num_truth)
        cells.append([_PROTOCOLS[str(protocol)], f"{iou_threshold:g}", str(subset), region, *values, count])
    header = ["", "IoU", "objects", "range m", "BEV AP", "BEV APH", "3D AP", "3D APH", "number"]
    return Table(title, header, cells)


def _left_out(metric: Metric) -> bool:
    region = (metric.min_range_m, metric.max_range_m)
    if metric.protocol == "waymo":
        return metric.iou_threshold != 0.7 and region not in RANGES_M[:2]
    return metric.protocol == "waymo_strict" and region != RANGES_M[0]


_WHICH = ("protocol", "view", "subset", "iou_threshold", "min_range_m", "max_range_m")
_CURVE = ("score_threshold", "recall", "precision", "heading_precision")
_BOX = ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")


def evaluation_tables(
    detector: str, dataset: str, answers: Sequence[SceneDetections], metrics: Sequence[Metric]
) -> dict[str, pa.Table]:
    """Build the tables of an evaluation by name; rows follow the order of scenes and metrics."""
    run = {"detector": detector, "dataset": dataset}
    frames = [answer.frame for answer in answers]
    found, truth = [frame.found for frame in frames], [frame.truth for frame in frames]
    values = [row for metric in metrics for row in _values(metric, len(frames))]
    curves = _joined([metric.curve for metric in metrics], *_CURVE)
    curves |= {key: [getattr(metric, key) for metric in metrics for _ in metric.curve.recall] for key in _WHICH}
    detections = _boxes(frames, found) | _joined(found, "labelled", "image_height_px")
    detections["score"] = _joined(found, "scores")["scores"]
    labels = _boxes(frames, truth) | _joined(truth, "num_points", "counts", "difficulty")
    labels["difficulty"] = [grade if grade >= 0 else None for grade in labels["difficulty"].tolist()]
    labels["name"] = [name for part in truth for name in part.names]
    labels["kind"] = [kind or None for part in truth for kind in part.kinds or ("",) * len(part.names)]
    times = {name: [getattr(answer, name) for answer in answers] for name in ("scene_ms", "detect_ms")}
    return {
        "metrics": _table("metrics", {key: [row[key] for row in values] for key in values[0]}, **run),
        "curves": _table("curves", curves, **run),
        "detections": _table("detections", detections, **run),
        "truth": _table("truth", labels, dataset=dataset),
        "timings": _table("timings", {"scene": [frame.scene for frame in frames], **times}, **run),
    }


def breakdown_tables(
    detector: str,
    dataset: str,
    frames: Sequence[DetectedFrame],
    vehicles: VehicleRows,
    groups: Sequence[BreakdownRow],
) -> dict[str, pa.Table]:
    """Build the tables ``vehicles`` and ``breakdown``."""
    run = {"detector": detector, "dataset": dataset}
    matched = np.isfinite(vehicles.score).tolist()
    names = ("row", "range_m", "num_points", "score", "iou_bev", "iou_3d")
    columns: dict[str, Any] = {name: getattr(vehicles, name) for name in names}
    columns["scene"] = [frames[index].scene for index in vehicles.frame.tolist()]
    columns["kind"] = [kind or None for kind in vehicles.kind]
    columns["aspect"] = list(vehicles.aspect)
    columns["flipped"] = [flip if has else None for flip, has in zip(vehicles.flipped.tolist(), matched)]
    columns |= {f"error_{name}": vehicles.errors[:, index] for index, name in enumerate(ERRORS)}
    rows = {field.name: [getattr(group, field.name) for group in groups] for field in fields(BreakdownRow)}
    return {"vehicles": _table("vehicles", columns, **run), "breakdown": _table("breakdown", rows, **run)}


def _table(name: str, columns: Mapping[str, Any], **same: str) -> pa.Table:
    """Build a table of columns, and of constant values shared by all rows."""
    rows = len(next(iter(columns.values())))
    return evaluation_table(name, {**columns, **{key: [value] * rows for key, value in same.items()}})


def _values(metric: Metric, num_scenes: int) -> list[dict[str, object]]:
    curve = metric.curve
    same = {key: getattr(metric, key) for key in _WHICH}
    same |= {"recall": float(curve.recall.max(initial=0.0)), "num_truth": curve.num_truth, "num_scenes": num_scenes}
    named = (("AP", curve.average_precision), ("APH", curve.average_precision_heading))
    return [{**same, "metric": name, "value": value} for name, value in named]


def _joined(parts: Sequence[object], *names: str) -> dict[str, Any]:
    """Concatenate the named arrays of all parts."""
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}


def _boxes(frames: Sequence[DetectedFrame], parts: Sequence[FrameDetections | GroundTruth]) -> dict[str, Any]:
    """Return scene and box columns of the detections or the ground truth of all frames, one row per box."""
    scenes = [frame.scene for frame, part in zip(frames, parts, strict=True) for _ in part.boxes]
    return {"scene": scenes, **dict(zip(_BOX, _joined(parts, "boxes")["boxes"].T, strict=True))}
