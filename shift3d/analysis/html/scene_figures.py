"""Figures of vehicles in scenes: paired 3D views, views from above, and tiles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.analysis.cases.rendered import VIEW_M, Rendered, oriented, simplified
from shift3d.analysis.cases.selection import Case
from shift3d.analysis.cases.suite_views import FrozenView
from shift3d.analysis.figures.picture import COLOURS, pixels_png
from shift3d.analysis.html.blocks import Panels, Plot, TurnButtons
from shift3d.analysis.html.figure import LEGEND_BELOW, axis, marks, plot
from shift3d.geometry.boxes import corners_bev
from shift3d.vehicles.picture import shaded

FloatArray = NDArray[np.float64]
RGB = tuple[float, float, float]
_TILE_PX, _SPAN_M = (170, 105), 5.6
_TOWARDS_EYE = np.array([1.15, 1.15, 0.55]) / np.linalg.norm([1.15, 1.15, 0.55])
_VIEW_ANGLE, _ASPECT = math.pi / 4, 1.9  # vertical angle of plotly's camera; style.css gives 3D views this aspect
_LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.15, "roughness": 0.7}
_NO_MARGIN = {"l": 0, "r": 0, "t": 0, "b": 0}
_PAIR = ("baseline", "adversarial")


def paired_3d_views(key: str, case: Case, before: Rendered, after: Rendered) -> tuple[Panels, TurnButtons]:
    """Create 3D views of baseline and adversarial vehicle at the same scale; rotating one rotates the other."""
    meshes = [_mesh(rendered, float(before.theta[3])) for rendered in (before, after)]
    both = np.concatenate([vertices for vertices, _ in meshes])
    layout = {"scene": _stage(both.min(axis=0) - 0.05, both.max(axis=0) + 0.05), "margin": _NO_MARGIN}
    views = []
    for name, other, rendered, mesh in zip(_PAIR, reversed(_PAIR), (before, after), meshes):
        label = f"3D view of the {case.vehicle.replace('_', ' ')}, {name}, score {rendered.score:.2f}"
        caption = f"{name.capitalize()}: score {rendered.score:.3f}, {rendered.object_points} points on the vehicle"
        traces = [_trace(*mesh, COLOURS[name])]
        views.append(plot(f"{key}-{name}", traces, layout, label, caption, pair=f"{key}-{other}"))
    return Panels(views), TurnButtons(f"{key}-baseline", "both vehicles")


def _mesh(rendered: Rendered, yaw_rad: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return vertices (V, 3) in scene orientation, turned back by the baseline's heading, and triangles (F, 3)."""
    vertices, faces = simplified(rendered.mesh)
    return oriented(vertices, rendered.theta, yaw_rad).round(4).astype(np.float32), faces


def _trace(vertices: NDArray[np.float32], faces: NDArray[np.int32], colour: str) -> dict[str, Any]:
    parts = {name: vertices[:, column] for column, name in enumerate("xyz")}
    sides = {name: faces[:, column] for column, name in enumerate("ijk")}
    light = {"lighting": _LIGHT, "lightposition": {"x": 2000, "y": 3000, "z": 6000}}
    return {"type": "mesh3d", **parts, **sides, "color": colour, "flatshading": False, "hoverinfo": "skip", **light}


def _stage(low: FloatArray, high: FloatArray) -> dict[str, Any]:
    """Create hidden axes in true proportion, the same for both vehicles, and a camera that sees the whole stage."""
    extent = high - low
    eye = dict(zip("xyz", (_TOWARDS_EYE * _distance(extent / extent.mean())).tolist()))
    hidden = {
        f"{name}axis": {"visible": False, "range": [float(low[i]), float(high[i])]} for i, name in enumerate("xyz")
    }
    ratio = {name: float(extent[i] / extent.mean()) for i, name in enumerate("xyz")}
    return {**hidden, "aspectmode": "manual", "aspectratio": ratio, "camera": {"eye": eye}, "dragmode": "turntable"}


def _distance(size: FloatArray) -> float:
    """Compute the least distance from which a camera at `_TOWARDS_EYE` sees a box of this size (3,) around 0."""
    right = np.array([-_TOWARDS_EYE[1], _TOWARDS_EYE[0], 0.0]) / np.hypot(*_TOWARDS_EYE[:2])
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    across, up, near = (corners @ side for side in (right, np.cross(_TOWARDS_EYE, right), _TOWARDS_EYE))
    half = math.tan(_VIEW_ANGLE / 2)
    return float(np.max(near + np.maximum(np.abs(across) / _ASPECT, np.abs(up)) / half))


def top_views(key: str, case: Case, before: Rendered, after: Rendered, centre_xy: FloatArray) -> Panels:
    """Create views of the scene around the vehicle before and after, with ground truth and best box."""
    views = []
    for name, rendered in zip(_PAIR, (before, after)):
        colour = COLOURS["adversarial" if name == "adversarial" else "random"]
        traces, best = top_view_traces(rendered, colour, "points on the vehicle")
        label = f"The scene from above, {case.vehicle.replace('_', ' ')} {name}: {best}"
        away = float(np.hypot(*rendered.theta[:2]))
        caption = f"{name.capitalize()}: {best}; sensor frame, {away:.1f} m from the sensor"
        views.append(square_plot(f"{key}-above-{name}", traces, label, caption, centre_xy, VIEW_M, 420))
    return Panels(views)


def top_view_traces(view: Rendered | FrozenView, colour: str, name: str) -> tuple[list[dict[str, Any]], str]:
    """Create traces of points, ground truth and best box, and a text about the box. colour, name: object's points."""
    traces = [
        dots(view.scene_xy, "#8a8a8a", 2, "scene"),
        dots(view.object_xy, colour, 3, name),
        outline(view.box, "#2f9e44", "dash", "ground truth"),
    ]
    if view.found is None:
        return traces, "no box within the detection radius"
    best = f"best box {view.score:.3f}"
    return [*traces, outline(view.found, "#9b5de5", "solid", best.replace("box", "box,"))], best


def square_plot(
    key: str,
    traces: list[dict[str, Any]],
    label: str,
    caption: str,
    middle: FloatArray,
    half_m: float,
    height_px: int = 380,
    names: tuple[str, str] = ("x, m", "y, m"),
) -> Plot:
    """Create a figure of a square of the plane around `middle` (2,), metres, at true scale. names: of the axes."""
    spans = [{"range": [round(float(centre) - half_m, 2), round(float(centre) + half_m, 2)]} for centre in middle]
    layout = {
        "xaxis": axis(names[0], **spans[0], constrain="domain", zeroline=False),
        "yaxis": axis(names[1], **spans[1], scaleanchor="x", constrain="domain", zeroline=False),
        "legend": LEGEND_BELOW,
    }
    return plot(key, traces, layout, label, caption, height_px)


def dots(points: FloatArray, colour: str, size: int, name: str) -> dict[str, Any]:
    """Create dots for points (P, 2)."""
    at = {axis_name: np.round(points[:, i], 2).astype(np.float32) for i, axis_name in enumerate("xy")}
    return marks(marker={"size": size, "color": colour}, name=name, hoverinfo="skip", **at)


def outline(box: FloatArray, colour: str, dash: str, name: str) -> dict[str, Any]:
    """Create a box's footprint, with a stroke from its centre to its front."""
    corners = corners_bev(box[None])[0]
    front = (corners[0] + corners[3]) / 2.0
    path = np.concatenate((corners, corners[:1], [[np.nan, np.nan]], box[None, :2], front[None]))
    at = {
        axis_name: [None if np.isnan(v) else round(float(v), 3) for v in path[:, i]] for i, axis_name in enumerate("xy")
    }
    line = {"color": colour, "dash": dash, "width": 2}
    return {"type": "scatter", "mode": "lines", **at, "line": line, "name": name, "hoverinfo": "name"}


def side_by_side(meshes: Sequence[trimesh.Trimesh], towards: Sequence[float], colours: Sequence[RGB]) -> bytes:
    """Render vehicles side by side as one PNG, slightly from above, at a car's scale unless a vehicle is longer.

    towards: (N,) azimuths from which they are viewed, radians. colours: (N,) of the vehicles.
    """
    span_m = max(_SPAN_M, *(1.08 * float(mesh.extents.max()) for mesh in meshes))
    views = [shaded(mesh, at, 0.22, *_TILE_PX, span_m, rgb) for mesh, at, rgb in zip(meshes, towards, colours)]
    return pixels_png(np.concatenate(views, axis=1))
