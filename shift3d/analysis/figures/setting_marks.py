"""Marks of settings in a work-precision diagram: a colour per method, markers, rings, lines and labels."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb

from shift3d.accuracy_time.pareto import effective_error_m
from shift3d.analysis.figures.labels import PointLabel

FloatArray = npt.NDArray[np.float64]

# Kelly's colours of maximum contrast without his yellows and greys, which are invisible on white. Each method also has
# its own marker, so that colour vision is not needed.
_COLOURS = (
    *("#0067A5", "#F38400", "#008856", "#BE0032", "#604E97", "#8DB600", "#E68FAC", "#882D17", "#A1CAF1"),
    *("#F6A600", "#B3446C", "#2B3D26", "#F99379", "#875692", "#C2B280", "#E25822", "#654522"),
)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "p", "d", "H", "8")
_SIZE, _STAR, _RING = 6.0, 13.0, 4.5  # points: marker, preset marker, and increment per ring
RING = "ring"  # gid of a ring around a marker; the ring is a setting that renders the same as the marker inside.


@dataclass(frozen=True)
class Style:
    """Colour and marker of a method."""

    colour: str
    marker: str


_PRESETS = Style("#000000", "*")


def styles_of(frame: pd.DataFrame) -> dict[str, Style]:
    """Assign a colour and a marker to each method in the frame's order; presets are black stars."""
    presets = set(frame.loc[frame["preset"].notna(), "method"])
    others = map(Style, itertools.cycle(_COLOURS), itertools.cycle(_MARKERS))
    return {name: _PRESETS if name in presets else next(others) for name in dict.fromkeys(frame["method"])}


def joined(rows: pd.DataFrame) -> list[Any]:
    """Return the row numbers of each line: a method's settings ordered by their knob, or one setting without a knob."""
    lines: list[Any] = []
    knobs, methods = rows["knob"].to_numpy(dtype=np.float64), rows["method"].to_numpy()
    for method in dict.fromkeys(methods):
        swept = np.flatnonzero((methods == method) & ~np.isnan(knobs))
        if len(swept):
            lines.append(swept[np.argsort(knobs[swept], kind="stable")])
        lines += [np.array([row]) for row in np.flatnonzero((methods == method) & np.isnan(knobs))]
    return lines


def mark_settings(axes: Axes, rows: pd.DataFrame, x: FloatArray, styles: dict[str, Style]) -> None:
    """Draw one marker per setting, presets first; at an occupied position one ring per further method."""
    front = rows["pareto"].to_numpy(dtype=bool)
    there: dict[tuple[float, float], list[str]] = {}
    for row in np.argsort(rows["preset"].isna().to_numpy(), kind="stable"):
        place, method = (float(x[row]), float(rows["ms_median"].iloc[row])), str(rows["method"].iloc[row])
        style, drawn = styles[method], there.setdefault(place, [])
        if method in drawn:
            continue
        if drawn:
            size, colour = _STAR + (len(drawn) - 1) * _RING, style.colour
            axes.plot(*place, marker="o", ls="none", ms=size, mfc="none", mec=colour, mew=1.5, zorder=5, gid=RING)
        else:
            size, own = _STAR if style.marker == "*" else _SIZE, style.colour
            face, edge, width, zorder = (own, "white", 0.6, 4) if front[row] else ("white", own, 1.2, 3)
            axes.plot(*place, marker=style.marker, ls="none", ms=size, mfc=face, mec=edge, mew=width, zorder=zorder)
        drawn.append(method)


def same_as_presets(frame: pd.DataFrame) -> list[str]:
    """Return the methods whose every setting has a preset's time and error, such as detector methods."""
    places = list(zip(frame["scenes"], frame["ms_median"], effective_error_m(frame)))
    presets = {place for place, preset in zip(places, frame["preset"].notna()) if preset}
    others = {str(method) for method, place in zip(frame["method"], places) if place not in presets}
    named = {str(method) for method in frame.loc[frame["preset"].notna(), "method"]}
    return [method for method in dict.fromkeys(map(str, frame["method"])) if method not in others | named]


def labels_of(rows: pd.DataFrame, x: FloatArray, styles: dict[str, Style]) -> list[PointLabel]:
    """Create labels: presets by name; front settings in their method's colour, by knob value or else by name.

    Settings at one position, such as those that render the same, share one label.
    """
    found: list[PointLabel] = []
    for row in np.argsort(rows["preset"].isna().to_numpy(), kind="stable"):
        setting = rows.iloc[row]
        place, preset = (float(x[row]), float(setting["ms_median"])), isinstance(setting["preset"], str)
        if preset or (setting["pareto"] and place not in [(label.x, label.y) for label in found]):
            text = str(setting["setting"]) if np.isnan(setting["knob"]) else f"{setting['knob']:g}"
            found.append(PointLabel(text, *place, preset, _dark(styles[setting["method"]].colour)))
    return found


def _dark(colour: str) -> str:
    """Darken a colour so that text in it is readable on white."""
    red, green, blue = to_rgb(colour)
    return to_hex((0.7 * red, 0.7 * green, 0.7 * blue))
