"""What each effect is worth, where the sweep ran with and without it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from shift3d.effects.applicability import IMPACT_BOUND
from shift3d.errors import InputError
from shift3d.report.effects import EffectWorth, effect_milliseconds, effect_worths
from shift3d.report.html.document import Section, paragraph, table
from shift3d.report.html.figure import axis, figure_html
from shift3d.report.html.sweep import Sweep
from shift3d.report.resampling import Interval

__all__ = ["effects"]

_HEADER = ["effect", "scenes", "objects", "|change| of baseline score", "change of baseline AUC",
           "change of adversarial AUC", "ms a rendering", "effects=auto"]  # fmt: skip
_LEAST, _LEAST_MS = 1e-4, 0.5


def effects(sweep: Sweep) -> Section:
    """The section; one line where the sweep has no pairs with and without one effect."""
    try:
        worths = effect_worths(sweep.scores, effect_milliseconds(sweep.scores, sweep.timings))
    except InputError as error:
        text = f"Not measured by this sweep: {error.what}. {error.remedy}."
        return Section("effects", "Effects", [paragraph(text, "missing")])
    lead = (
        "The same vehicles at the same places, without effects and with one at a time; 95 % intervals, scenes redrawn. "
        f"effects=auto leaves out what moves the score by less than {IMPACT_BOUND:g} with 95 % confidence."
    )
    lines = [_line(worth) for worth in worths]
    kinds = ["ours" if worth.worth.matters else "" for worth in worths]
    body = [paragraph(lead), table("What each effect is worth", _HEADER, lines, kinds), _figure(worths)]
    return Section("effects", "Effects", body)


def _line(worth: EffectWorth) -> list[str]:
    return [
        worth.effect.replace("_", " "),
        str(worth.scenes),
        str(worth.objects),
        _interval(worth.score_change, sign=""),
        _interval(worth.auc_baseline),
        "-" if worth.auc_adversarial is None else _interval(worth.auc_adversarial),
        f"{worth.milliseconds:.0f}",
        "takes it" if worth.worth.matters else "leaves it out",
    ]


def _interval(interval: Interval, sign: str = "+") -> str:
    if not math.isfinite(interval.low):
        return f"{interval.mean:{sign}.3f} (one scene)"
    return f"{interval.mean:{sign}.3f} [{interval.low:{sign}.3f}, {interval.high:{sign}.3f}]"


def _figure(worths: list[EffectWorth]) -> str:
    x = [round(max(worth.milliseconds, _LEAST_MS), 3) for worth in worths]
    y = [round(max(worth.score_change.mean, _LEAST), 6) for worth in worths]
    points: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers+text",
        "x": x,
        "y": y,
        "text": [worth.effect.replace("_", " ") for worth in worths],
        "textposition": "top center",
        "marker": {"size": 9, "color": ["#d55e00" if worth.worth.matters else "#7d7d7d" for worth in worths]},
        "hovertemplate": "%{text}: |change| %{y:.4f} for %{x:.0f} ms<extra></extra>",
    }
    if all(math.isfinite(worth.score_change.high) for worth in worths):
        upper = [max(worth.score_change.high, _LEAST) - at for worth, at in zip(worths, y)]
        lower = [at - max(worth.score_change.low, _LEAST) for worth, at in zip(worths, y)]
        points["error_y"] = {
            "type": "data",
            "color": "#7d7d7d",
            "array": np.round(upper, 6),
            "arrayminus": np.round(lower, 6),
        }
    bound = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": IMPACT_BOUND, "y1": IMPACT_BOUND}
    layout = {
        "xaxis": axis("milliseconds a rendering, more", type="log"),
        "yaxis": axis("mean |change of score|", type="log"),
        "shapes": [{**bound, "line": {"dash": "dash", "width": 1, "color": "#7d7d7d"}}],
        "showlegend": False,
    }
    caption = (
        f"Below the dashed line effects=auto leaves an effect out; under {_LEAST_MS:g} ms or {_LEAST:g} drawn there."
    )
    label = "Change of the score by effect against its time; the table before it has the numbers"
    return figure_html("effects", [points], layout, label, caption, height_px=420)
