"""Pictures of a scene: from above, and a three-quarter view."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shift3d.geometry.boxes import corners_3d, corners_bev
from shift3d.scenes.scene import Scene
from shift3d.store.atomic import write_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection

BOX_COLOURS = {"vehicle": "tab:red", "pedestrian": "tab:green", "cyclist": "tab:orange"}
_REACH_M = 50.0  # half the side of the square of the view from above
_EYE_M, _LOOK_AT_M = (-18.0, 10.0, 16.0), (14.0, 0.0, -1.5)  # of the three-quarter view, scene frame
_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))


def draw_bev(axes: Axes, scene: Scene, free_m: NDArray[np.float64] | None = None) -> PathCollection:
    """Draw points from above, coloured by height above ground, x up the page, y to the left; labels with a nose.

    Args:
        axes: matplotlib axes.
        free_m: (N, 2) free placements to mark.

    Returns: the points, for a colour bar.
    """
    points = scene.points[(np.abs(scene.points[:, :2]) < _REACH_M).all(axis=1)]
    height = points[:, 2] - scene.ground_z_m
    drawn = axes.scatter(points[:, 1], points[:, 0], s=0.5, c=height, cmap="viridis_r", vmin=-0.5, vmax=3, lw=0)
    if free_m is not None and len(free_m):
        axes.scatter(
            free_m[:, 1], free_m[:, 0], s=18, c="tab:blue", marker="+", lw=0.8, label=f"{len(free_m)} places for a car"
        )
    for box, name in zip(scene.labels.boxes, scene.labels.classes, strict=True):
        corners = corners_bev(box[None])[0]
        nose = (corners[0] + corners[3]) / 2
        outline = np.concatenate((corners, corners[:1]))
        axes.plot(outline[:, 1], outline[:, 0], lw=0.8, c=_colour(name))
        axes.plot([box[1], nose[1]], [box[0], nose[0]], lw=0.8, c=_colour(name))
    for name, count in sorted(Counter(scene.labels.classes).items()):
        axes.plot([], [], c=_colour(name), label=f"{count} {name}")
    axes.plot(0.0, 0.0, "k^", ms=5, label="sensor, facing up")
    axes.legend(loc="upper right", fontsize=7)
    axes.set(xlim=(_REACH_M, -_REACH_M), ylim=(-_REACH_M, _REACH_M), aspect="equal", title=scene.scene_id)
    axes.set(xlabel="y, to the left, m", ylabel="x, ahead, m")
    return drawn


def draw_view(axes: Axes, scene: Scene) -> None:
    """Draw a perspective view from a raised eye, far points first, labels as wire boxes."""
    eye = np.array(_EYE_M)
    camera = _camera(eye, np.array(_LOOK_AT_M))
    image, depth = _project(scene.points.astype(np.float64), eye, camera)
    front = depth > 1.0
    order = np.argsort(-depth[front])
    height = (scene.points[front][:, 2] - scene.ground_z_m)[order]
    size = 0.8 * np.clip(25.0 / depth[front][order], 0.3, 3.0) ** 2
    axes.scatter(
        image[front][order, 0], image[front][order, 1], s=size, c=height, cmap="viridis_r", vmin=-0.5, vmax=3, lw=0
    )
    for box, name in zip(scene.labels.boxes, scene.labels.classes, strict=True):
        corners, far = _project(corners_3d(box[None])[0], eye, camera)
        if (far > 1.0).all():
            for a, b in _EDGES:
                axes.plot(*corners[[a, b]].T, lw=0.7, c=_colour(name))
    axes.set(xlim=(-0.75, 0.75), ylim=(-0.42, 0.42), aspect="equal")
    axes.set_axis_off()


def save_picture(scene: Scene, path: Path | str, free_m: NDArray[np.float64] | None = None) -> None:
    """Write both views side by side as a PNG. free_m: see `draw_bev`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(19, 7.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    points = draw_bev(left, scene, free_m)
    figure.colorbar(points, ax=left, label="height above the ground at the sensor, m", shrink=0.6, extend="both")
    draw_view(right, scene)
    write_atomic(Path(path), lambda temporary: figure.savefig(temporary, format="png"))


def _colour(name: str) -> str:
    return BOX_COLOURS.get(name, "tab:gray")


def _camera(eye: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes of a camera at `eye` that looks at `target`, as rows: right, up, forward."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(right, forward), forward))


def _project(
    points: NDArray[np.float64], eye: NDArray[np.float64], camera: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    seen = (points - eye) @ camera.T
    return seen[:, :2] / np.maximum(seen[:, 2:], 1e-6), seen[:, 2]
