"""Arrow schemas of an evaluation's folder, and columns to tables of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

__all__ = ["EVALUATION_SCHEMAS", "EVALUATION_SCHEMA_VERSION", "evaluation_table"]

EVALUATION_SCHEMA_VERSION = 2

_BOX = [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")]
_RUN = [("detector", pa.string()), ("dataset", pa.string())]
# What a value or a curve is of. Null ranges: no limit.
_WHICH = [
    *_RUN,
    ("protocol", pa.string()),
    ("view", pa.string()),
    ("subset", pa.string()),
    ("iou_threshold", pa.float64()),
    ("min_range_m", pa.float64()),
    ("max_range_m", pa.float64()),
]


def _schema(name: str, fields: list[tuple[str, pa.DataType]], nullable: set[str]) -> pa.Schema:
    metadata = {"shift3d.schema": name, "shift3d.schema_version": str(EVALUATION_SCHEMA_VERSION)}
    return pa.schema([pa.field(n, kind, nullable=n in nullable) for n, kind in fields], metadata=metadata)


_RANGES = {"min_range_m", "max_range_m"}
EVALUATION_SCHEMAS: dict[str, pa.Schema] = {
    # metric: AP or APH. value: null where there is nothing to find. recall: the highest that was reached.
    "metrics": _schema(
        "evaluation_metrics",
        [
            *_WHICH,
            ("metric", pa.string()),
            ("value", pa.float64()),
            ("recall", pa.float64()),
            ("num_truth", pa.int64()),
            ("num_scenes", pa.int64()),
        ],
        {*_RANGES, "value"},
    ),
    "curves": _schema(
        "evaluation_curves",
        [
            *_WHICH,
            ("score_threshold", pa.float64()),
            ("recall", pa.float64()),
            ("precision", pa.float64()),
            ("heading_precision", pa.float64()),
        ],
        _RANGES,
    ),
    # Boxes in the scene frame. image_height_px: null without a camera.
    "detections": _schema(
        "evaluation_detections",
        [
            *_RUN,
            ("scene", pa.string()),
            *_BOX,
            ("score", pa.float64()),
            ("labelled", pa.bool_()),
            ("image_height_px", pa.float64()),
        ],
        {"image_height_px"},
    ),
    # difficulty: 0 easy, 1 moderate, 2 hard, 3 harder; null where the labels carry none.
    "truth": _schema(
        "evaluation_truth",
        [
            ("dataset", pa.string()),
            ("scene", pa.string()),
            ("name", pa.string()),
            *_BOX,
            ("num_points", pa.int64()),
            ("counts", pa.bool_()),
            ("difficulty", pa.int64()),
            ("kind", pa.string()),
        ],
        {"difficulty", "kind"},
    ),
    # A row a vehicle that counts, within any range. row: of the scene's labels. aspect: the side that the beam to its
    # centre meets: front, side, rear, oblique. score, flipped and errors: of the best detection with a bird's-eye IoU
    # of at least 0.5; null without one. Errors: found less true, x and y along and across the true vehicle, heading of
    # the axis, half turns taken out.
    "vehicles": _schema(
        "evaluation_vehicles",
        [
            *_RUN,
            ("scene", pa.string()),
            ("row", pa.int64()),
            ("kind", pa.string()),
            ("range_m", pa.float64()),
            ("num_points", pa.int64()),
            ("aspect", pa.string()),
            ("score", pa.float64()),
            ("iou_bev", pa.float64()),
            ("iou_3d", pa.float64()),
            ("flipped", pa.bool_()),
            *((f"error_{name}", kind) for name, kind in _BOX),
        ],
        {"kind", "score", "flipped", *(f"error_{name}" for name, _ in _BOX)},
    ),
    # by: all, range, heading, points, body, attribute; group: which. measure and statistic: AP and APH (Waymo's,
    # LEVEL_1, IoU 0.7; BEV or 3D), recall (at a score of 0.3, by IoU), flips, error_x_m and the like (median, mean,
    # std). low, high: 95 % interval over resampled scenes, null for fewer than two. number: of vehicles.
    "breakdown": _schema(
        "evaluation_breakdown",
        [
            *_RUN,
            ("by", pa.string()),
            ("group", pa.string()),
            ("measure", pa.string()),
            ("statistic", pa.string()),
            ("value", pa.float64()),
            ("low", pa.float64()),
            ("high", pa.float64()),
            ("number", pa.int64()),
        ],
        {"value", "low", "high"},
    ),
    # Apart from the rest, because no two runs take the same time.
    "timings": _schema(
        "evaluation_timings",
        [*_RUN, ("scene", pa.string()), ("scene_ms", pa.float64()), ("detect_ms", pa.float64())],
        set(),
    ),
}


def evaluation_table(name: str, columns: Mapping[str, Sequence[Any] | np.ndarray[Any, Any]]) -> pa.Table:
    """Columns of equal length as a table of the schema ``name``. NaN in a column that may be null becomes null.

    Raises:
        ValueError: a column is missing or unknown, or one that may not be null holds None, NaN or infinity.
    """
    schema = EVALUATION_SCHEMAS[name]
    if set(columns) != set(schema.names):
        raise ValueError(f"{name}: columns {sorted(set(columns) ^ set(schema.names))} are missing or unknown")
    arrays = []
    for field in schema:
        array = pa.array(columns[field.name], type=field.type, from_pandas=field.nullable)
        broken = array.null_count > 0 and not field.nullable
        if pa.types.is_floating(field.type):
            broken |= not np.isfinite(array.drop_null().to_numpy()).all()
        if broken:
            raise ValueError(f"{name}.{field.name} holds a value that is missing or not finite")
        arrays.append(array)
    return pa.Table.from_arrays(arrays, schema=schema)
