"""Diagrams of a sweep: impact of effects on the score, and scores and margins after verification."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from shift3d.analysis.figures.labels import FloatArray, PointLabel, place_labels
from shift3d.analysis.figures.picture import COLOURS
from shift3d.effects.applicability import IMPACT_BOUND, MeasuredImpact
from shift3d.methods import METHODS

_LEAST_MS, _LEAST = 0.5, 1e-4
_MEANING = {True: "effects=auto takes it: its interval reaches the line", False: "effects=auto leaves it out"}


def effects_figure(impacts: Mapping[str, MeasuredImpact]) -> Figure:
    """Plot the change of the baseline's score against milliseconds; auto omits effects whose bar is below the line.

    An effect without a measured time is not drawn, nor is the bar of an infinite interval.
    """
    figure = Figure(figsize=(7.2, 4.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    labels, bars = list[PointLabel](), list[FloatArray]()
    for effect, impact in impacts.items():
        if np.isnan(impact.milliseconds):
            continue
        x, y = max(impact.milliseconds, _LEAST_MS), max(impact.score_change, _LEAST)
        colour = "#d55e00" if impact.matters else "#707070"
        if np.isfinite(impact.high):
            bars.append(np.array([[x, max(impact.low, _LEAST)], [x, max(impact.high, _LEAST)]]))
            axes.plot(*bars[-1].T, color=colour, lw=1.2)
        axes.plot(x, y, "o", color=colour, ms=5, label=_MEANING[impact.matters])
        labels.append(PointLabel(effect.replace("_", " "), x, y))
    axes.axhline(IMPACT_BOUND, color="#202020", lw=0.8, ls="--", label=f"a change of {IMPACT_BOUND:g}")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(f"extra milliseconds per rendering (drawn at {_LEAST_MS:g} if less)")
    axes.set_ylabel(f"mean |change of score| (drawn at {_LEAST:g} if less)")
    axes.grid(True, which="major", color="#e4e4e4", lw=0.6)
    axes.set_xlim(_LEAST_MS / 2)  # room for labels of effects that take no time
    handles = {text: handle for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    figure.draw_without_rendering()
    bound = np.array([[x, IMPACT_BOUND] for x in axes.get_xlim()])
    place_labels(axes, labels, np.array([[label.x, label.y] for label in labels]), [*bars, bound])
    return figure


_MARKERS = {"adversarial_noise": "x", "random": "s", "random_budget": "^", "edited": "D"}


def stability_figure(verification: pd.DataFrame) -> Figure:
    """Plot scores against those of the reference, and margins against the least margin of the draws."""
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
    right.axline((0, 0), slope=1, color="0.6", linewidth=0.8, zorder=0, label="full margin kept")
    right.axline((0, 0), slope=0.5, color="0.6", linewidth=0.8, linestyle="--", zorder=0, label="half of it kept")
    right.set(
        xlabel="margin: baseline's score minus the solution's", ylabel="smallest margin under noise and pose offset"
    )
    for axes in (left, right):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False)
    return figure
