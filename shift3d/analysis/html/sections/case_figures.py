"""The pictures of a hard case: two 3D views that turn together, and the scene from above before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.cases.chosen import Case
from shift3d.analysis.cases.rendered import VIEW_M, Rendered, oriented, simplified
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Panels, TurnButtons
from shift3d.analysis.html.figure import LEGEND_BELOW, axis, plot
from shift3d.geometry.boxes import corners_bev

FloatArray = NDArray[np.float64]
_EYE = {"x": 1.15, "y": 1.15, "z": 0.55}
_LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.15, "roughness": 0.7}
_NO_MARGIN = {"l": 0, "r": 0, "t": 0, "b": 0}
_PAIR = ("baseline", "adversarial")


def turnable(key: str, case: Case, before: Rendered, after: Rendered) -> tuple[Panels, TurnButtons]:
    """Baseline and adversarial vehicle side by side, same scale; one turns with the other."""
    meshes = [_mesh(rendered, float(before.theta[3])) for rendered in (before, after)]
    both = np.concatenate([vertices for vertices, _ in meshes])
    layout = {"scene": _stage(both.min(axis=0) - 0.05, both.max(axis=0) + 0.05), "margin": _NO_MARGIN}
    views = []
    for name, other, rendered, mesh in zip(_PAIR, reversed(_PAIR), (before, after), meshes):
        label = f"3D view of the {case.vehicle.replace('_', ' ')}, {name}, score {rendered.score:.2f}"
        caption = f"{name.capitalize()}: score {rendered.score:.3f}, {rendered.object_points} points on it"
        traces = [_trace(*mesh, COLOURS[name])]
        views.append(plot(f"{key}-{name}", traces, layout, label, caption, 300, pair=f"{key}-{other}"))
    return Panels(views), TurnButtons(f"{key}-baseline", "both vehicles")


def _mesh(rendered: Rendered, yaw_rad: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Vertices (V, 3) as they stand in the scene, turned back by the baseline's heading, and triangles (F, 3)."""
    vertices, faces = simplified(rendered.mesh)
    return oriented(vertices, rendered.theta, yaw_rad).round(4).astype(np.float32), faces


def _trace(vertices: NDArray[np.float32], faces: NDArray[np.int32], colour: str) -> dict[str, Any]:
    parts = {name: vertices[:, column] for column, name in enumerate("xyz")}
    sides = {name: faces[:, column] for column, name in enumerate("ijk")}
    light = {"lighting": _LIGHT, "lightposition": {"x": 2000, "y": 3000, "z": 6000}}
    return {"type": "mesh3d", **parts, **sides, "color": colour, "flatshading": False, "hoverinfo": "skip", **light}


def _stage(low: FloatArray, high: FloatArray) -> dict[str, Any]:
    """Axes without lines, the same for both vehicles, in true proportion."""
    extent = high - low
    hidden = {
        f"{name}axis": {"visible": False, "range": [float(low[i]), float(high[i])]} for i, name in enumerate("xyz")
    }
    ratio = {name: float(extent[i] / extent.mean()) for i, name in enumerate("xyz")}
    return {**hidden, "aspectmode": "manual", "aspectratio": ratio, "camera": {"eye": _EYE}, "dragmode": "turntable"}


def from_above(key: str, case: Case, before: Rendered, after: Rendered, centre_xy: FloatArray) -> Panels:
    """The scene around the vehicle before and after, with the ground truth and the detector's best box."""
    sides = [{"range": [round(float(centre) - VIEW_M, 2), round(float(centre) + VIEW_M, 2)]} for centre in centre_xy]
    layout = {
        "xaxis": axis("x, m", **sides[0], constrain="domain", zeroline=False),
        "yaxis": axis("y, m", **sides[1], scaleanchor="x", constrain="domain", zeroline=False),
        "legend": LEGEND_BELOW,
    }
    views = []
    for name, rendered in zip(_PAIR, (before, after)):
        best = f"best box {rendered.score:.3f}"
        best = best if rendered.found is not None else "no box within the detection radius"
        label = f"The scene from above, {case.vehicle.replace('_', ' ')} {name}: {best}"
        away = float(np.hypot(*rendered.theta[:2]))
        caption = f"{name.capitalize()}: {best}; sensor frame, {away:.1f} m from the sensor"
        views.append(plot(f"{key}-above-{name}", _above(name, rendered), layout, label, caption, 420))
    return Panels(views)


def _above(name: str, rendered: Rendered) -> list[dict[str, Any]]:
    own = COLOURS["adversarial" if name == "adversarial" else "random"]
    traces = [
        dots(rendered.scene_xy, "#8a8a8a", 2, "scene"),
        dots(rendered.object_xy, own, 3, "vehicle's points"),
        outline(rendered.box, "#2f9e44", "dash", "ground truth"),
    ]
    if rendered.found is not None:
        traces.append(outline(rendered.found, "#9b5de5", "solid", f"best box, {rendered.score:.3f}"))
    return traces


def dots(points: FloatArray, colour: str, size: int, name: str) -> dict[str, Any]:
    """Points (P, 2) as dots."""
    at = {axis_name: np.round(points[:, i], 2).astype(np.float32) for i, axis_name in enumerate("xy")}
    marker = {"size": size, "color": colour}
    return {"type": "scatter", "mode": "markers", **at, "marker": marker, "name": name, "hoverinfo": "skip"}


def outline(box: FloatArray, colour: str, dash: str, name: str) -> dict[str, Any]:
    """A box's footprint, with a stroke from its middle to its front."""
    corners = corners_bev(box[None])[0]
    front = (corners[0] + corners[3]) / 2.0
    path = np.concatenate((corners, corners[:1], [[np.nan, np.nan]], box[None, :2], front[None]))
    at = {
        axis_name: [None if np.isnan(v) else round(float(v), 3) for v in path[:, i]] for i, axis_name in enumerate("xy")
    }
    line = {"color": colour, "dash": dash, "width": 2}
    return {"type": "scatter", "mode": "lines", **at, "line": line, "name": name, "hoverinfo": "name"}
