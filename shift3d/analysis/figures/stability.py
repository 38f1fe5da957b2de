"""How a sweep's scores and margins stand when they are scored again."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from shift3d.analysis.figures.picture import COLOURS
from shift3d.methods import METHODS

_MARKERS = {"adversarial_noise": "x", "random": "s", "random_search": "^", "edited": "D"}


def stability_figure(verification: pd.DataFrame) -> Figure:
    """Scores against those of the reference, and margins against the least margin of the draws."""
    figure = Figure(figsize=(11, 4.6), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for method, label in METHODS.items():
        rows = verification[verification["method"] == method]
        if not len(rows):
            continue
        style = {"s": 14, "alpha": 0.6, "color": COLOURS[method], "marker": _MARKERS.get(method, "o"), "label": label}
        left.scatter(rows["score"], rows["score_reference"], **style)
        if method != "baseline":
            least = rows[["least_margin_noise", "least_margin_nearby"]].min(axis=1)
            right.scatter(rows["margin"], least, **style)
    left.plot([0, 1], [0, 1], color="0.6", linewidth=0.8, zorder=0, label="equal")
    left.set(xlabel="score, as reported", ylabel="score at reference accuracy", xlim=(0, 1), ylim=(0, 1))
    right.axline((0, 0), slope=1, color="0.6", linewidth=0.8, zorder=0, label="all of it is kept")
    right.axline((0, 0), slope=0.5, color="0.6", linewidth=0.8, linestyle="--", zorder=0, label="half is kept")
    right.set(xlabel="baseline's score minus the solution's", ylabel="least of it under noise and off the pose")
    for axes in (left, right):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False)
    return figure
