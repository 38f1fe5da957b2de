"""How far effects move the score, against the time that they take."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

from matplotlib.figure import Figure

from shift3d.analysis.tables.effects import EffectImpact
from shift3d.effects.applicability import IMPACT_BOUND

_LEAST_MS, _LEAST = 0.5, 1e-4


def effects_figure(impacts: Sequence[EffectImpact]) -> Figure:
    """Change of the baseline's score against milliseconds; what lies below the line is left out by auto."""
    figure = Figure(figsize=(7.2, 4.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    drawn: list[tuple[float, float]] = []
    for impact in sorted(impacts, key=lambda impact: -impact.milliseconds):  # from the right, so that labels make room
        change = impact.score_change
        x, y = max(impact.milliseconds, _LEAST_MS), max(change.mean, _LEAST)
        colour = "#d55e00" if impact.measured.matters else "#707070"
        axes.plot([x, x], [max(change.low, _LEAST), max(change.high, _LEAST)], color=colour, lw=1.2)
        axes.plot(x, y, "o", color=colour, ms=5)
        to_left = any(abs(log(x / a)) < 0.7 and abs(log(y / b)) < 0.5 and x <= a for a, b in drawn) or x > 500.0
        offset, side = ((-5, 3), "right") if to_left else ((5, 3), "left")
        label = impact.effect.replace("_", " ")
        axes.annotate(label, (x, y), xytext=offset, textcoords="offset points", fontsize=8, ha=side)
        drawn.append((x, y))
    axes.axhline(IMPACT_BOUND, color="#202020", lw=0.8, ls="--")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(f"milliseconds a rendering, more (less than {_LEAST_MS:g} drawn there)")
    axes.set_ylabel(f"mean |change of score| (less than {_LEAST:g} drawn there)")
    axes.grid(True, which="major", color="#e4e4e4", lw=0.6)
    return figure
