"""Work-precision diagram of a frontier, as SciMLBenchmarks draw solvers of differential equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from shift3d.accuracy_time.pareto import ZERO_BELOW, effective_error_m, log_axis_errors, misplaced_share
from shift3d.analysis.figures.labels import place_labels
from shift3d.analysis.figures.setting_marks import Style, joined, labels_of, mark_settings, same_as_presets, styles_of
from shift3d.analysis.tables.table import length, milliseconds, share

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Panel:
    """Error axis of a panel. name_of: formats its tick labels. least: smallest error if no value is positive."""

    title: str
    values: Callable[[Any], FloatArray]
    name_of: Callable[[float], str]
    least: float


_PANELS = (
    _Panel("depth error of a beam, failures included", effective_error_m, length, 1e-9),
    _Panel("hits missed or on a wrong surface", misplaced_share, share, 1e-5),
)


def work_precision_figure(frame: pd.DataFrame, scenes: str | None = None) -> Figure:
    """Plot the time of a rendering against its error, both logarithmic; lower left is better.

    Left: effective error. Right: share of hits that are missed or on a wrong surface. A line with markers is a method
    swept over its knob; bars are the quartiles of the time. Each method has a colour. Dominated settings are hollow;
    presets and other settings on the front are named. Settings at one position, such as those that render the same, are
    rings around the first one. A method that renders exactly as presets do is only named in the legend. An error of
    zero is placed left of the dashed line.

    Args:
        frame: the frontier's table.
        scenes: one set; None: all sets of the frame, with a row of panels each, and one more for settings with
            gradient.

    Returns: A figure whose layout is final, with an Agg canvas.

    Raises: ValueError: a set has no rows.
    """
    names = dict.fromkeys(frame["scenes"]) if scenes is None else [scenes]
    same = same_as_presets(frame)
    drawn = frame[~frame["method"].isin(same)]
    groups = [group for name in names for group in _groups(drawn[drawn["scenes"] == name], name)]
    styles = styles_of(drawn)
    figure = Figure(figsize=(11, 1.2 + 4.8 * len(groups)), dpi=140, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(groups), 2, squeeze=False, sharey="row")
    for (title, rows), pair in zip(groups, axes):
        for panel, part in zip(_PANELS, pair):
            _draw(part, rows, panel, styles)
        _label_times(pair, rows, title)
    _legend(figure, drawn, styles, same)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels are placed in the final layout
    for (_, rows), pair in zip(groups, axes):
        for panel, part in zip(_PANELS, pair):
            _place_labels(part, rows, log_axis_errors(panel.values(rows), panel.least), styles)
    return figure


def _groups(rows: pd.DataFrame, name: str) -> list[tuple[str, pd.DataFrame]]:
    """Split settings into renderings without and with gradient, titled. Raises ValueError: there are no settings."""
    if rows.empty:
        raise ValueError(f"no setting was measured on the scenes {name!r}")
    ready = rows["gradient"].isin(["shape", "pose"])
    parts = [(name, rows[~ready]), (f"{name}, with gradient", rows[ready])]
    return [(title, part) for title, part in parts if len(part)]


def _draw(axes: Axes, rows: pd.DataFrame, panel: _Panel, styles: dict[str, Style]) -> None:
    values = panel.values(rows)
    x, times = log_axis_errors(values, panel.least), rows["ms_median"].to_numpy()
    spread = np.stack((times - rows["ms_low"], rows["ms_high"] - times))
    methods = rows["method"].to_numpy()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for line in joined(rows):
        style = styles[methods[line[0]]]
        axes.plot(x[line], times[line], color=style.colour, lw=1.2, alpha=0.6, zorder=2)
        axes.errorbar(x[line], times[line], spread[:, line], fmt="none", ecolor=style.colour, elinewidth=0.7, zorder=2)
    mark_settings(axes, rows, x, styles)
    _mark_errors(axes, values, panel)
    axes.set_xlabel(panel.title, fontsize=9)
    axes.grid(which="major", color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _mark_errors(axes: Axes, values: FloatArray, panel: _Panel) -> None:
    """Set limits and ticks of the horizontal axis: decades, and zero if there is a zero."""
    axes.xaxis.set_minor_locator(NullLocator())
    positive = values[values > 0]
    if not len(positive):
        axes.set_xlim(panel.least / ZERO_BELOW / 10, panel.least / ZERO_BELOW * 10)
        axes.set_xticks([panel.least / ZERO_BELOW], ["none"])
        return
    least, most = float(positive.min()), float(positive.max())
    zero, has_zero = least / ZERO_BELOW, len(positive) < len(values)
    axes.set_xlim(zero / 3 if has_zero else least / 4, most * 4)
    ticks = _ticks(least / 3, most * 3)
    labels = [panel.name_of(tick) for tick in ticks]
    if has_zero:
        axes.axvline(zero * 8, color="#b0b0b0", lw=0.8, ls=(0, (4, 3)), zorder=1)
        ticks, labels = [zero, *ticks], ["none", *labels]
    axes.set_xticks(ticks, labels)


def _ticks(low: float, high: float) -> list[float]:
    """Choose about eight round ticks at most: 1, 2, 5 of each decade, every decade, or every nth decade."""
    decades = math.log10(high / low)
    every = max(1, math.ceil(decades / 7))
    # Decades are counted from 1 (1 m, 100 % or 1 ms), so that the remaining ticks are the roundest.
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    parts = (1, 2, 5) if decades < 1.8 else (1,)
    ticks = [part * 10.0**decade for decade in range(first, last + 1) if decade % every == 0 for part in parts]
    return [tick for tick in ticks if low <= tick <= high]


def _label_times(pair: Sequence[Axes], rows: pd.DataFrame, name: str) -> None:
    """Label the shared vertical axis: milliseconds on the left of the pair, the ratio to paper on its right."""
    left, right = pair
    low, high = float(rows["ms_low"].min()) / 2, float(rows["ms_high"].max()) * 2
    left.set_ylim(low, high)
    left.set_yticks(_ticks(low, high))
    left.yaxis.set_major_formatter(FuncFormatter(lambda value, _: milliseconds(value)))
    left.yaxis.set_minor_formatter(NullFormatter())
    left.set_ylabel("rendering time (median, quartiles)", fontsize=9)
    paper_ms = float(rows["ms_median"].iloc[0] * rows["ratio_to_paper"].iloc[0])
    if math.isfinite(paper_ms):
        _label_ratios(right, paper_ms, low, high)
    renders, hits = int(rows["renders"].max()), int(rows["hits"].max())
    left.set_title(f"{name}: {renders:,} renderings, {hits:,} hits", fontsize=9, loc="left", fontweight="bold")
    right.set_title("faster and more accurate: lower left", fontsize=8, loc="right", color="#606060")


def _label_ratios(right: Axes, paper_ms: float, low: float, high: float) -> None:
    def other(value: Any) -> Any:
        return paper_ms / np.maximum(value, 1e-300)

    ratio = right.secondary_yaxis("right", functions=(other, other))
    ratio.set_yticks(_ticks(paper_ms / high, paper_ms / low))
    ratio.yaxis.set_minor_locator(NullLocator())
    ratio.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}\N{MULTIPLICATION SIGN}"))
    ratio.set_ylabel("times as fast as paper as published", fontsize=9)
    ratio.tick_params(labelsize=8)


def _place_labels(axes: Axes, rows: pd.DataFrame, x: FloatArray, styles: dict[str, Style]) -> None:
    places = np.stack((x, rows["ms_median"].to_numpy()), axis=1)
    bars = np.stack((np.stack((x, rows["ms_low"]), axis=1), np.stack((x, rows["ms_high"]), axis=1)), axis=1)
    place_labels(axes, labels_of(rows, x, styles), places, [*(places[line] for line in joined(rows)), *bars])


def _legend(figure: Figure, frame: pd.DataFrame, styles: dict[str, Style], same: Sequence[str]) -> None:
    entries = []
    for method, style in styles.items():
        knobs = frame.loc[(frame["method"] == method) & frame["knob"].notna()]
        size = 11 if style.marker == "*" else 6
        line = "-" if len(knobs) else "none"
        label = f"{method}{_swept(knobs)}"
        entries.append(Line2D([], [], color=style.colour, marker=style.marker, ms=size, ls=line, lw=1.3, label=label))
    black: dict[str, Any] = {"color": "black", "marker": "o", "mfc": "white", "ls": "none"}
    entries.append(Line2D([], [], ms=6, label="hollow: dominated", **black))
    entries.append(Line2D([], [], ms=10, mew=1.5, label="ring: renders the same as the setting inside", **black))
    if same:
        entries.append(Line2D([], [], ls="none", label=f"render the same as presets: {', '.join(same)}"))
    figure.legend(handles=entries, loc="outside lower center", ncols=3, fontsize=8, frameon=False)


def _swept(rows: pd.DataFrame) -> str:
    """Format the range of a knob: " (step 0.4 to 0.0125 m)" for knobs named step_m."""
    if rows.empty:
        return ""
    name, _, unit = str(rows["knob_name"].iloc[0]).rpartition("_")
    if unit not in ("m", "ms", "rad"):
        name, unit = f"{name} {unit}".strip().replace("_", " "), ""
    first, last = rows["knob"].iloc[0], rows["knob"].iloc[-1]
    span = f"{first:.3g}" if first == last else f"{first:.3g} to {last:.3g}"
    return f" ({name.replace('_', ' ')} {span} {unit}".rstrip() + ")"
