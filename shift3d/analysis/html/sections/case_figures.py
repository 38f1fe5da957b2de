"""The pictures of a hard case: two 3D views that turn together, and the scene from above before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from shift3d.analysis.cases.hardest import VIEW_M, Case, Seen, simplified
from shift3d.analysis.html.figure import COLOURS, LEGEND_BELOW, axis, figure_html, turn_buttons
from shift3d.geometry.boxes import corners_bev
from shift3d.geometry.se3 import scene_from_object

__all__ = ["from_above", "turnable"]

FloatArray = NDArray[np.float64]
_EYE = {"x": 1.15, "y": 1.15, "z": 0.55}
_LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.15, "roughness": 0.7}


def turnable(key: str, case: Case, before: Seen, after: Seen) -> str:
    """Baseline and adversarial vehicle side by side, same scale; one turns with the other."""
    meshes = [_standing(seen, float(before.theta[3])) for seen in (before, after)]
    both = np.concatenate([vertices for vertices, _ in meshes])
    low, high = both.min(axis=0) - 0.05, both.max(axis=0) + 0.05
    views = []
    named = (("baseline", "adversarial", before), ("adversarial", "baseline", after))
    for (name, other, seen), mesh in zip(named, meshes):
        label = f"3D view of the {case.vehicle.replace('_', ' ')}, {name}, score {seen.score:.2f}"
        traces = [_mesh(*mesh, COLOURS[name])]
        caption = f"{name[0].upper()}{name[1:]}: score {seen.score:.3f}, {seen.object_points} points on it"
        views.append(
            figure_html(
                f"{key}-{name}", traces, {"scene": _stage(low, high), "margin": _NO_MARGIN}, label, caption, 300,
                pair=f"{key}-{other}",
            )
        )  # fmt: skip
    return f'<div class="panels">{"".join(views)}</div>{turn_buttons(f"{key}-baseline", "both vehicles")}'


_NO_MARGIN = {"l": 0, "r": 0, "t": 0, "b": 0}


def _standing(seen: Seen, yaw_rad: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The mesh as it stands in the scene, tilt and heading included, turned back by the baseline's heading."""
    vertices, faces = simplified(seen.mesh)
    pose = torch.from_numpy(seen.theta.copy())
    pose[:3], pose[3] = 0.0, pose[3] - yaw_rad
    turned = scene_from_object(torch.from_numpy(vertices).double(), pose).numpy()
    return np.round(turned, 4).astype(np.float32), faces


def _mesh(vertices: NDArray[np.float32], faces: NDArray[np.int32], colour: str) -> dict[str, Any]:
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


def from_above(key: str, case: Case, before: Seen, after: Seen, centre_xy: FloatArray) -> str:
    """The scene around the vehicle before and after, with the ground truth and the detector's best box."""
    views = []
    for name, seen in (("baseline", before), ("adversarial", after)):
        best = f"best box {seen.score:.3f}" if seen.found is not None else "no box within the detection radius"
        layout = {
            "xaxis": axis("x, m", range=_around(centre_xy[0]), constrain="domain", zeroline=False),
            "yaxis": axis("y, m", range=_around(centre_xy[1]), scaleanchor="x", constrain="domain", zeroline=False),
            "legend": LEGEND_BELOW,
        }
        label = f"The scene from above, {case.vehicle.replace('_', ' ')} {name}: {best}"
        away = float(np.hypot(*seen.theta[:2]))
        caption = f"{name[0].upper()}{name[1:]}: {best}; sensor frame, {away:.1f} m from the sensor"
        views.append(figure_html(f"{key}-above-{name}", _above(name, seen), layout, label, caption, 420))
    return f'<div class="panels">{"".join(views)}</div>'


def _around(centre: float) -> list[float]:
    return [round(float(centre) - VIEW_M, 2), round(float(centre) + VIEW_M, 2)]


def _above(name: str, seen: Seen) -> list[dict[str, Any]]:
    traces = [
        _dots(seen.scene_xy, "#8a8a8a", 2, "scene"),
        _dots(seen.object_xy, COLOURS["adversarial" if name == "adversarial" else "random"], 3, "vehicle's points"),
        _outline(seen.box, "#2f9e44", "dash", "ground truth"),
    ]
    if seen.found is not None:
        traces.append(_outline(seen.found, "#9b5de5", "solid", f"best box, {seen.score:.3f}"))
    return traces


def _dots(points: FloatArray, colour: str, size: int, name: str) -> dict[str, Any]:
    at = {axis_name: np.round(points[:, i], 2).astype(np.float32) for i, axis_name in enumerate("xy")}
    marker = {"size": size, "color": colour}
    return {"type": "scatter", "mode": "markers", **at, "marker": marker, "name": name, "hoverinfo": "skip"}


def _outline(box: FloatArray, colour: str, dash: str, name: str) -> dict[str, Any]:
    """A box's footprint, with a stroke from its middle to its front."""
    corners = corners_bev(box[None])[0]
    front = (corners[0] + corners[3]) / 2.0
    path = np.concatenate((corners, corners[:1], [[np.nan, np.nan]], box[None, :2], front[None]))
    at = {
        axis_name: [None if np.isnan(v) else round(float(v), 3) for v in path[:, i]] for i, axis_name in enumerate("xy")
    }
    line = {"color": colour, "dash": dash, "width": 2}
    return {"type": "scatter", "mode": "lines", **at, "line": line, "name": name, "hoverinfo": "name"}
