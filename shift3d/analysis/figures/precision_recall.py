"""Precision-recall curves of a detector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from shift3d.analysis.tables.table import number
from shift3d.evaluation.metrics import RANGES_M, Metric

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["precision_recall_figure"]


def precision_recall_figure(metrics: Sequence[Metric], title: str) -> Figure:
    """Waymo's precision-recall curves, 0-75 m: bird's-eye view and 3D, both levels, both IoU thresholds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.8), dpi=110, layout="constrained")
    axes = dict(zip(("BEV", "3D"), figure.subplots(1, 2, sharey=True)))
    colours = {"LEVEL_1": "#c03030", "LEVEL_2": "#4878a8"}
    for metric in metrics:
        if metric.protocol != "waymo" or (metric.min_range_m, metric.max_range_m) != RANGES_M[0]:
            continue
        label = f"{metric.subset}, IoU {metric.iou_threshold:g}: {number(metric.curve.average_precision)}"
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
    return figure
