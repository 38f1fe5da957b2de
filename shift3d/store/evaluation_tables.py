"""Arrow schemas of the tables in an evaluation folder, and their construction from columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from shift3d.store.schemas import schema_of_columns
from shift3d.store.tables import check_table

EVALUATION_SCHEMA_VERSION = 2

_BOX = "x_m y_m z_m dx_m dy_m dz_m heading_rad"
_ERRORS = " ".join(f"error_{name}" for name in _BOX.split())
# Key columns of a metric or curve. A null range means no limit.
_WHICH = "detector dataset protocol view subset iou_threshold min_range_m? max_range_m?"
_NUMBERS = (
    f"{_BOX} {_ERRORS} iou_threshold min_range_m max_range_m value recall score_threshold precision heading_precision "
    "score image_height_px range_m iou_bev iou_3d low high scene_ms detect_ms"
)
_TYPES = dict.fromkeys(_NUMBERS.split(), "float64")
_TYPES |= dict.fromkeys(("num_truth", "num_scenes", "num_points", "difficulty", "row", "number"), "int64")
_TYPES |= dict.fromkeys(("labelled", "counts", "flipped"), "bool")
_COLUMNS = {
    # metric: AP or APH. value: null without ground truth. recall: the highest recall reached.
    "metrics": f"{_WHICH} metric value? recall num_truth num_scenes",
    "curves": f"{_WHICH} score_threshold recall precision heading_precision",
    # Boxes in the scene frame. image_height_px: null without a camera.
    "detections": f"detector dataset scene {_BOX} score labelled image_height_px?",
    # difficulty: 0 easy, 1 moderate, 2 hard, 3 harder; null if the labels have none.
    "truth": f"dataset scene name {_BOX} num_points counts difficulty? kind?",
    # One row per vehicle that counts, at any range. row: index among the scene's labels. aspect: side that the beam to
    # the vehicle's centre meets: front, side, rear, oblique. score, flipped and errors: of the best detection with a
    # bird's-eye IoU of at least 0.5; null without one. Errors: detection minus ground truth, x and y along and across
    # the true vehicle, heading modulo half turns.
    "vehicles": (
        "detector dataset scene row kind? range_m num_points aspect score? iou_bev iou_3d flipped? "
        + " ".join(f"{name}?" for name in _ERRORS.split())
    ),
    # by: all, range, heading, points, body, attribute; group: value of `by`. measure and statistic: AP and APH
    # (Waymo's, LEVEL_1, IoU 0.7; BEV or 3D), recall (at a score of 0.3, by IoU), flips, error_x_m and the like (median,
    # mean, std). low, high: 95 % interval over resampled scenes, null for fewer than two. number: of vehicles.
    "breakdown": "detector dataset by group measure statistic value? low? high? number",
    # A separate table, because times differ from run to run.
    "timings": "detector dataset scene scene_ms detect_ms",
}
EVALUATION_SCHEMAS: dict[str, pa.Schema] = {
    name: schema_of_columns(f"evaluation_{name}", EVALUATION_SCHEMA_VERSION, columns, _TYPES)
    for name, columns in _COLUMNS.items()
}


def evaluation_table(name: str, columns: Mapping[str, Sequence[Any] | np.ndarray[Any, Any]]) -> pa.Table:
    """Return columns of equal length as a table of the schema ``name``. NaN in a nullable column becomes null.

    Raises:
        ValueError: a column is missing or unknown. InputError: a non-nullable column holds None, NaN or infinity.
    """
    schema = EVALUATION_SCHEMAS[name]
    if set(columns) != set(schema.names):
        raise ValueError(f"{name}: columns {sorted(set(columns) ^ set(schema.names))} are missing or unknown")
    arrays = [pa.array(columns[field.name], type=field.type, from_pandas=field.nullable) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema)
    check_table(table, schema, name)
    return table
