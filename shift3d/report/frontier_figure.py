"""The work-precision diagram of a frontier, as SciMLBenchmarks draw solvers of differential equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shift3d.report.labels import PointLabel, place_labels
from shift3d.report.numbers import length, milliseconds, share
from shift3d.report.pareto import ZERO_BELOW, drawable, effective_error_m, misplaced

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["work_precision_figure"]

FloatArray = npt.NDArray[np.float64]

# Okabe and Ito's palette without its yellow, which is lost on white. Each method has a marker of its own as well, so
# that nobody needs colours to tell methods apart.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7A4B2A")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "p")
_PRESETS = "#000000", "*"
_FACE, _EDGE = "#d0d0d0", "#8c8c8c"  # of dominated settings


@dataclass(frozen=True)
class _Style:
    colour: str
    marker: str


@dataclass(frozen=True)
class _Panel:
    """An error to draw the time against. name_of: its tick labels. least: where no positive value says how small."""

    title: str
    values: Callable[[Any], FloatArray]
    name_of: Callable[[float], str]
    least: float


_PANELS = (
    _Panel("error of a beam's depth, every failure counted", effective_error_m, length, 1e-9),
    _Panel("hits missed or on a wrong surface", misplaced, share, 1e-5),
)


def work_precision_figure(frame: pd.DataFrame, scenes: str | Sequence[str] | None = None) -> Figure:
    """Time of a rendering against its error, both logarithmic; lower left is better.

    A line with markers is a method swept over its knob, bars are the quartiles of the time. Settings that are
    dominated are grey; presets and the other settings on the front are named. To the left the effective error, to
    the right the share of hits that are missed or on a wrong surface. An error of zero has a place of its own, left
    of the dashed line.

    Args:
        frame: the frontier's table.
        scenes: one set or several, a row of panels each; None: all sets of the frame.

    Returns:
        A figure whose layout is final, with an Agg canvas.

    Raises:
        ValueError: a set has no rows.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [scenes] if isinstance(scenes, str) else list(scenes or dict.fromkeys(frame["scenes"]))
    groups = [frame[frame["scenes"] == name] for name in names]
    for name, rows in zip(names, groups):
        if rows.empty:
            raise ValueError(f"no setting was measured on the scenes {name!r}")
    styles = _styles(frame)
    figure = Figure(figsize=(11, 0.9 + 4.6 * len(names)), dpi=140, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(names), 2, squeeze=False, sharey="row")
    for name, rows, pair in zip(names, groups, axes):
        for panel, part in zip(_PANELS, pair):
            _draw(part, rows, panel, styles)
        _label_times(pair, rows, name)
    _legend(figure, frame, styles)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels are placed between what has its place now
    for rows, pair in zip(groups, axes):
        for panel, part in zip(_PANELS, pair):
            _place_labels(part, rows, drawable(panel.values(rows), panel.least))
    return figure


def _styles(frame: pd.DataFrame) -> dict[str, _Style]:
    methods = list(dict.fromkeys(frame["method"]))
    presets = set(frame.loc[frame["preset"].notna(), "method"])
    styles, count = {}, 0
    for method in methods:
        if method in presets:
            styles[method] = _Style(*_PRESETS)
        else:
            styles[method] = _Style(_COLOURS[count % len(_COLOURS)], _MARKERS[count % len(_MARKERS)])
            count += 1
    return styles


def _joined(rows: pd.DataFrame) -> list[Any]:
    """Row numbers of what one line joins: a method's settings by their knob; what has no knob stands alone."""
    lines: list[Any] = []
    knobs, methods = rows["knob"].to_numpy(dtype=np.float64), rows["method"].to_numpy()
    for method in dict.fromkeys(methods):
        swept = np.flatnonzero((methods == method) & ~np.isnan(knobs))
        if len(swept):
            lines.append(swept[np.argsort(knobs[swept], kind="stable")])
        lines += [np.array([row]) for row in np.flatnonzero((methods == method) & np.isnan(knobs))]
    return lines


def _draw(axes: Axes, rows: pd.DataFrame, panel: _Panel, styles: dict[str, _Style]) -> None:
    values = panel.values(rows)
    x, times = drawable(values, panel.least), rows["ms_median"].to_numpy()
    spread = np.stack((times - rows["ms_low"], rows["ms_high"] - times))
    front, methods = rows["pareto"].to_numpy(dtype=bool), rows["method"].to_numpy()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for line in _joined(rows):
        style = styles[methods[line[0]]]
        axes.plot(x[line], times[line], color=style.colour, lw=1.2, alpha=0.6, zorder=2)
        axes.errorbar(x[line], times[line], spread[:, line], fmt="none", ecolor=style.colour, elinewidth=0.7, zorder=2)
        for row in line:
            face, edge = (style.colour, "white") if front[row] else (_FACE, _EDGE)
            size = 13 if style.marker == "*" else 7
            axes.plot(
                x[row],
                times[row],
                marker=style.marker,
                ms=size,
                mfc=face,
                mec=edge,
                mew=0.6,
                ls="none",
                zorder=4 if front[row] else 3,
            )
    _mark_errors(axes, values, panel)
    axes.set_xlabel(panel.title, fontsize=9)
    axes.grid(which="major", color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _mark_errors(axes: Axes, values: FloatArray, panel: _Panel) -> None:
    """Limits and ticks of the horizontal axis: decades, and zero where there is one."""
    from matplotlib.ticker import NullLocator

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
    """Round numbers on a logarithmic axis, at most about eight: 1, 2, 5 of each decade, decades, or some of them."""
    decades = math.log10(high / low)
    every = max(1, math.ceil(decades / 7))
    # Counted from one metre, one per cent or one millisecond, so that the ticks that are left are the roundest.
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    parts = (1, 2, 5) if decades < 2.5 else (1,)
    ticks = [part * 10.0**decade for decade in range(first, last + 1) if decade % every == 0 for part in parts]
    return [tick for tick in ticks if low <= tick <= high]


def _label_times(pair: Sequence[Axes], rows: pd.DataFrame, name: str) -> None:
    """The shared vertical axis: milliseconds to the left of the pair, the ratio to paper to its right."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    left, right = pair
    low, high = float(rows["ms_low"].min()) / 2, float(rows["ms_high"].max()) * 2
    left.set_ylim(low, high)
    left.set_yticks(_ticks(low, high))
    left.yaxis.set_major_formatter(FuncFormatter(lambda value, _: milliseconds(value)))
    left.yaxis.set_minor_formatter(NullFormatter())
    left.set_ylabel("time of a rendering (median, quartiles)", fontsize=9)
    paper_ms = float(rows["ms_median"].iloc[0] * rows["ratio_to_paper"].iloc[0])
    if math.isfinite(paper_ms):
        _label_ratios(right, paper_ms, low, high)
    renders, hits = int(rows["renders"].max()), int(rows["hits"].max())
    left.set_title(f"{name}: {renders:,} renderings, {hits:,} hits", fontsize=9, loc="left", fontweight="bold")
    right.set_title("faster and more accurate: lower left", fontsize=8, loc="right", color="#606060")


def _label_ratios(right: Axes, paper_ms: float, low: float, high: float) -> None:
    """A second vertical axis: how many times as fast as paper, where that was measured."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    def other(value: Any) -> Any:
        return paper_ms / np.maximum(value, 1e-300)

    ratio = right.secondary_yaxis("right", functions=(other, other))
    ratio.set_yticks(_ticks(paper_ms / high, paper_ms / low))
    ratio.yaxis.set_minor_locator(NullLocator())
    ratio.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}\N{MULTIPLICATION SIGN}"))
    ratio.set_ylabel("times as fast as paper", fontsize=9)
    ratio.tick_params(labelsize=8)


def _place_labels(axes: Axes, rows: pd.DataFrame, x: FloatArray) -> None:
    places = np.stack((x, rows["ms_median"].to_numpy()), axis=1)
    bars = np.stack((np.stack((x, rows["ms_low"]), axis=1), np.stack((x, rows["ms_high"]), axis=1)), axis=1)
    place_labels(axes, _labels(rows, x), places, [*(places[line] for line in _joined(rows)), *bars])


def _labels(rows: pd.DataFrame, x: FloatArray) -> list[PointLabel]:
    """Presets, and what is on the front; of settings in one place, as those that render the same are, one names all."""
    points = list(zip(rows["setting"], x, rows["ms_median"], rows["preset"].notna(), rows["pareto"]))
    labels = [PointLabel(str(name), float(e), float(ms), True) for name, e, ms, preset, _ in points if preset]
    for name, error, time, preset, front in points:
        taken = any((label.x, label.y) == (float(error), float(time)) for label in labels)
        if front and not preset and not taken:
            labels.append(PointLabel(str(name), float(error), float(time)))
    return labels


def _legend(figure: Figure, frame: pd.DataFrame, styles: dict[str, _Style]) -> None:
    from matplotlib.lines import Line2D

    entries = []
    for method, style in styles.items():
        knobs = frame.loc[(frame["method"] == method) & frame["knob"].notna()]
        size = 11 if style.marker == "*" else 6
        line = "-" if len(knobs) else "none"
        label = f"{method}{_swept(knobs)}"
        entries.append(Line2D([], [], color=style.colour, marker=style.marker, ms=size, ls=line, lw=1.3, label=label))
    dominated = Line2D([], [], marker="o", ms=6, mfc=_FACE, mec=_EDGE, ls="none", label="dominated")
    figure.legend(handles=[*entries, dominated], loc="outside lower center", ncols=3, fontsize=8, frameon=False)


def _swept(rows: pd.DataFrame) -> str:
    """ " (step 0.4 to 0.0125 m)" for knobs named step_m."""
    if rows.empty:
        return ""
    name, _, unit = str(rows["knob_name"].iloc[0]).rpartition("_")
    if unit not in ("m", "ms", "rad"):
        name, unit = f"{name} {unit}".strip().replace("_", " "), ""
    first, last = rows["knob"].iloc[0], rows["knob"].iloc[-1]
    return f" ({name.replace('_', ' ')} {first:.3g} to {last:.3g} {unit}".rstrip() + ")"
