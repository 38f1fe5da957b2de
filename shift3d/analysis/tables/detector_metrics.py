"""The printed table of a detector's metrics."""

from __future__ import annotations

from collections.abc import Sequence

from shift3d.analysis.tables.table import Table, number
from shift3d.evaluation.metrics import RANGES_M, Metric

__all__ = ["metric_table"]

_PROTOCOLS = {
    "waymo": "Waymo",
    "waymo_strict": "Waymo, strict",
    "kitti": "KITTI, 40 recalls",
    "shift3d": "exact area",
}


def metric_table(title: str, metrics: Sequence[Metric]) -> Table:
    """AP and APH in both views, a line a definition, IoU threshold, subset and range.

    Left out, and in metrics.parquet: Waymo's range bins at IoU 0.5, and its strict counting but for 0-75 m.
    """
    lines: dict[tuple[object, ...], dict[str, Metric]] = {}
    for metric in metrics:
        key = (metric.protocol, metric.iou_threshold, metric.subset, metric.min_range_m, metric.max_range_m)
        if not _left_out(metric):
            lines.setdefault(key, {})[metric.view] = metric
    # Definitions stay together, each with IoU 0.7 before 0.5.
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
