"""The Parquet tables of a detector's evaluation: metrics, groups, curves, vehicles, detections, ground truth, times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from shift3d.store.evaluation_tables import evaluation_table

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd
    import pyarrow as pa

    from shift3d.evaluation.breakdown import BreakdownRow
    from shift3d.evaluation.frames import DetectedFrame
    from shift3d.evaluation.metrics import Metric
    from shift3d.evaluation.vehicles import VehicleRows
    from shift3d.training.detector.detect_scenes import Answer

__all__ = ["breakdown_tables", "evaluation_tables"]

_WHICH = ("protocol", "view", "subset", "iou_threshold", "min_range_m", "max_range_m")
_BOX = ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")


def evaluation_tables(
    detector: str, dataset: str, answers: Sequence[Answer], metrics: Sequence[Metric]
) -> dict[str, pa.Table]:
    """The tables of an evaluation by name, rows in the order of the scenes and of the metrics."""
    import pandas as pd

    run = {"detector": detector, "dataset": dataset}
    frames = [answer.frame for answer in answers]
    times = [(answer.frame.scene, answer.scene_ms, answer.detect_ms) for answer in answers]
    found = [
        _boxes(f.scene, f.found.boxes, score=f.found.scores, labelled=f.found.labelled,
               image_height_px=f.found.image_height_px)
        for f in frames
    ]  # fmt: skip
    truth = [
        _boxes(f.scene, f.truth.boxes, name=f.truth.names, num_points=f.truth.num_points, counts=f.truth.counts,
               difficulty=f.truth.difficulty,
               kind=[kind or None for kind in f.truth.kinds or ("",) * len(f.truth.names)])
        for f in frames
    ]  # fmt: skip
    tables = {
        "metrics": pd.DataFrame([row for metric in metrics for row in _values(metric, len(frames))]).assign(**run),
        "curves": pd.concat([_curve(metric) for metric in metrics]).assign(**run),
        "detections": pd.concat(found).assign(**run),
        "truth": pd.concat(truth).assign(dataset=dataset),
        "timings": pd.DataFrame(times, columns=["scene", "scene_ms", "detect_ms"]).assign(**run),
    }
    known = tables["truth"]["difficulty"]
    tables["truth"]["difficulty"] = known.astype("Int64").where(known >= 0)
    texts = {"name": object, "kind": object}  # a column without a row has no type of its own
    tables["truth"] = tables["truth"].astype(texts)
    return {name: evaluation_table(name, {column: table[column] for column in table}) for name, table in tables.items()}


def breakdown_tables(
    detector: str,
    dataset: str,
    frames: Sequence[DetectedFrame],
    vehicles: VehicleRows,
    groups: Sequence[BreakdownRow],
) -> dict[str, pa.Table]:
    """The tables of vehicles and of groups by name."""
    import numpy as np

    from shift3d.evaluation.vehicles import ERRORS

    run = {"detector": detector, "dataset": dataset}
    matched = np.isfinite(vehicles.score).tolist()
    columns: dict[str, Any] = {key: [value] * len(vehicles.row) for key, value in run.items()}
    for name in ("row", "range_m", "num_points", "score", "iou_bev", "iou_3d"):
        columns[name] = getattr(vehicles, name)
    columns["scene"] = [frames[index].scene for index in vehicles.frame.tolist()]
    columns["kind"] = [kind or None for kind in vehicles.kind]
    columns["aspect"] = list(vehicles.aspect)
    columns["flipped"] = [flip if has else None for flip, has in zip(vehicles.flipped.tolist(), matched)]
    columns |= {f"error_{name}": vehicles.errors[:, index] for index, name in enumerate(ERRORS)}
    rows: dict[str, Any] = {key: [value] * len(groups) for key, value in run.items()}
    for name in ("by", "group", "measure", "statistic", "value", "low", "high", "number"):
        rows[name] = [getattr(group, name) for group in groups]
    return {"vehicles": evaluation_table("vehicles", columns), "breakdown": evaluation_table("breakdown", rows)}


def _values(metric: Metric, num_scenes: int) -> list[dict[str, object]]:
    """AP and APH."""
    curve = metric.curve
    same = {key: getattr(metric, key) for key in _WHICH}
    same |= {"recall": float(curve.recall.max(initial=0.0)), "num_truth": curve.num_truth, "num_scenes": num_scenes}
    named = (("AP", curve.average_precision), ("APH", curve.average_precision_heading))
    return [{**same, "metric": name, "value": value} for name, value in named]


def _curve(metric: Metric) -> pd.DataFrame:
    import pandas as pd

    columns = ("score_threshold", "recall", "precision", "heading_precision")
    points = pd.DataFrame({name: getattr(metric.curve, name) for name in columns})
    return points.assign(**{key: getattr(metric, key) for key in _WHICH})


def _boxes(scene: str, boxes: npt.NDArray[np.float64], **columns: Any) -> pd.DataFrame:
    """Boxes (K, 7) of one scene, a row each, with what else is known of them."""
    import pandas as pd

    texts = {"scene": [scene] * len(boxes), **{name: columns.pop(name) for name in ("name",) if name in columns}}
    frame = pd.DataFrame(boxes, columns=list(_BOX)).assign(**columns)
    # Texts are objects, of no rows too.
    return frame.assign(**{name: pd.Series(list(values), dtype=object) for name, values in texts.items()})
