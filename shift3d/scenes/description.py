"""Description of a scene's contents as text."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from shift3d.scenes.scene import Scene
from shift3d.wording import counted


def describe_scene(scene: Scene) -> list[str]:
    """Return ``name: value`` lines of the data that a scene has or lacks."""
    away = np.linalg.norm(scene.points.astype(np.float64) - scene.origins, axis=1)[scene.has_beam]
    low, middle, high = np.percentile(away, (5, 50, 95))
    lines = [
        ("scene", f"{scene.scene_id} ({scene.dataset})"),
        ("points", f"{len(scene.points):,}; ranges {low:.1f}, {middle:.1f}, {high:.1f} m (5 %, half, 95 %)"),
        ("beam origins", _origins(scene)),
        ("returns", _returns(scene)),
        ("firing times", "none" if scene.time_s is None else _span(scene.time_s, "s")),
        ("reflectance", "none" if scene.reflectance is None else _span(scene.reflectance, "")),
        ("beams without return", "unknown" if scene.no_return is None else f"{len(scene.no_return):,}"),
        ("ground", f"at {scene.ground_z_m:.2f} m, the sensor at 0"),
        ("map", _map(scene)),
        ("labels", _labels(scene)),
        *([("vehicles", vehicles)] if (vehicles := _vehicles(scene)) else []),
        ("conditions", _conditions(scene)),
    ]
    if scene.in_no_label_zone is not None:
        lines.append(("no-label zones", f"{100 * scene.in_no_label_zone.mean():.1f} % of the points"))
    return [f"{name + ':':<22}{value}" for name, value in lines]


def _origins(scene: Scene) -> str:
    places = np.unique(scene.origins, axis=0)
    if len(places) == 1:
        return "1 place"
    spread = np.linalg.norm(np.ptp(places, axis=0))
    return f"{len(places):,} places, up to {spread:.2f} m apart"


def _returns(scene: Scene) -> str:
    if scene.return_number is None:
        return "not numbered"
    counts = np.bincount(scene.return_number)
    return ", ".join(f"{count:,} of number {number + 1}" for number, count in enumerate(counts))


def _span(values: np.ndarray, unit: str) -> str:
    return f"{values.min():.3g} to {values.max():.3g} {unit}".rstrip()


def _map(scene: Scene) -> str:
    if scene.ground_map is None:
        return "none"
    known = f"heights of {100 * np.isfinite(scene.ground_map.height_m).mean():.0f} % of 120 m x 120 m"
    drivable = scene.ground_map.drivable
    return known if drivable is None else f"{known}; drivable {100 * drivable.mean():.0f} %"


def _labels(scene: Scene) -> str:
    labels = scene.labels
    if not len(labels.boxes):
        return "none"
    kinds = ", ".join(f"{count} {name}" for name, count in sorted(Counter(labels.classes).items()))
    empty = int((labels.num_points == 0).sum())
    return f"{kinds}; {counted(empty, 'box', 'boxes')} without points"


def _vehicles(scene: Scene) -> str | None:
    """Return the median size of the labelled vehicles; swapped columns and other frames show in it."""
    boxes = scene.labels.of_class("vehicle").reshape(-1, 7)
    if not len(boxes):
        return None
    length, width, height = np.median(boxes[:, 3:6], axis=0)
    bottom = float(np.median(boxes[:, 2] - boxes[:, 5] / 2)) - scene.ground_z_m
    where = f"{abs(bottom):.2f} m {'above' if bottom >= 0 else 'below'} the ground"
    return f"medians: {length:.2f} m long, {width:.2f} m wide, {height:.2f} m high, bottom {where}"


def _conditions(scene: Scene) -> str:
    conditions = scene.conditions
    words = [conditions.weather]
    if conditions.ego_velocity_m_s is not None:
        words.append(f"sensor at {math.hypot(*conditions.ego_velocity_m_s):.1f} m/s")
    return ", ".join(words)
