"""The printed table of a detector's metrics, and the picture of its precision-recall curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO

from shift3d.analysis.tables.printed import aligned
from shift3d.evaluation.metrics import RANGES_M, Metric

__all__ = ["draw_curves", "metric_table"]

_PROTOCOLS = {
    "waymo": "Waymo",
    "waymo_strict": "Waymo, strict",
    "kitti": "KITTI, 40 recalls",
    "shift3d": "exact area",
}


def metric_table(title: str, metrics: Sequence[Metric]) -> str:
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
            values += [_number(curve.average_precision), _number(curve.average_precision_heading)]
        region = "any" if high is None else f"{low:g}-{high:g}"
        count = str(views["BEV"].curve.num_truth)
        cells.append([_PROTOCOLS[str(protocol)], f"{iou_threshold:g}", str(subset), region, *values, count])
    header = ["", "IoU", "objects", "range m", "BEV AP", "BEV APH", "3D AP", "3D APH", "number"]
    return aligned(title, header, cells)


def _left_out(metric: Metric) -> bool:
    region = (metric.min_range_m, metric.max_range_m)
    if metric.protocol == "waymo":
        return metric.iou_threshold != 0.7 and region not in RANGES_M[:2]
    return metric.protocol == "waymo_strict" and region != RANGES_M[0]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def draw_curves(metrics: Sequence[Metric], title: str, file: IO[bytes]) -> None:
    """Waymo's precision-recall curves, 0-75 m, as PNG: bird's-eye view and 3D, both levels, both IoU thresholds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.8), dpi=110, layout="constrained")
    axes = dict(zip(("BEV", "3D"), figure.subplots(1, 2, sharey=True)))
    colours = {"LEVEL_1": "#c03030", "LEVEL_2": "#4878a8"}
    for metric in metrics:
        if metric.protocol != "waymo" or (metric.min_range_m, metric.max_range_m) != RANGES_M[0]:
            continue
        label = f"{metric.subset}, IoU {metric.iou_threshold:g}: {_number(metric.curve.average_precision)}"
        axes[metric.view].plot(
            metric.curve.recall,
            metric.curve.precision,
            color=colours[metric.subset],
            linestyle="-" if metric.iou_threshold == 0.7 else ":",
            marker=".",
            markersize=3,
            linewidth=1.0,
            label=label,
        )
    for view, panel in axes.items():
        panel.set(title=view, xlabel="recall", xlim=(0, 1.02), ylim=(0, 1.02))
        panel.legend(fontsize=7, loc="lower left", frameon=False)
    axes["BEV"].set_ylabel("precision")
    figure.suptitle(title, fontsize=9)
    figure.savefig(file, format="png", metadata={"Software": ""})
