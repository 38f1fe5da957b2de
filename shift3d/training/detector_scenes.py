"""Training scenes on disk: points and vehicle boxes in the network frame, one small .npz file per scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shift3d.geometry.boxes import points_in_boxes
from shift3d.processes import each
from shift3d.progress_bar import progress_bar
from shift3d.scenes.scene import Scene
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.store.user_cache import program_digest

# Source code that makes the scenes, including scenes with an object of a sweep.
_CODE = (
    *("scenes", "vehicles", "sdf", "geometry", "render", "effects", "task", "seeding.py", "processor.py"),
    *("training/detector_scenes.py", "training/inserted_vehicles.py"),
    *("attack/objective.py", "attack/problem.py", "finetuning/tune.py"),
)
KEPT_HALF_WIDTH_M = 80.0
FULL_CIRCLE_RAD = (0.0, float(np.pi))
MARGIN_M = 0.1  # mirrors and antennas protrude from a box


@dataclass(frozen=True)
class TrainingScene:
    """Points (N, 3) and vehicle boxes (M, 7) of one scene, float32, network frame (ground at 0), metres.

    sensor_height_m: the sensor is at (0, 0, sensor_height_m).
    """

    points: npt.NDArray[np.float32]
    boxes: npt.NDArray[np.float32]
    sensor_height_m: float


def network_points(scene: Scene) -> npt.NDArray[np.float32]:
    """Return the scene's points (N, 3) float32 in the detector's network frame: z from the nominal ground."""
    return scene.points - np.array((0.0, 0.0, scene.ground_z_m), dtype=np.float32)


def from_scene(scene: Scene, sector_rad: tuple[float, float] = FULL_CIRCLE_RAD) -> TrainingScene:
    """Keep the points that have a beam and |x|, |y| < 80 m, and the boxes of class vehicle.

    sector_rad: (centre, half width) of the labelled azimuths, as in `SceneSet.placement_sector_rad`. Unlabelled
    vehicles would train as background: points outside are dropped, except on vehicles whose centre is inside, and
    vehicles whose centre is outside are dropped with their points.
    """
    boxes = scene.labels.of_class("vehicle").astype(np.float32).reshape(-1, 7)
    boxes[:, 2] -= np.float32(scene.ground_z_m)
    return cut_scene(network_points(scene)[scene.has_beam], boxes, -float(scene.ground_z_m), sector_rad)


def cut_scene(
    points: npt.NDArray[np.float32],
    boxes: npt.NDArray[np.float32],
    sensor_height_m: float,
    sector_rad: tuple[float, float] = FULL_CIRCLE_RAD,
    keep_last_box: bool = False,
) -> TrainingScene:
    """Apply `from_scene` to points (N, 3) and vehicle boxes (M, 7) in the network frame. Boxes keep their order.

    keep_last_box: keep the last box even if its centre is outside the sector.
    """
    points = points[np.abs(points[:, :2]).max(axis=1) < KEPT_HALF_WIDTH_M]
    if sector_rad[1] < np.pi:
        points, boxes = _labelled_part(points, boxes, sector_rad, keep_last_box)
    return TrainingScene(points, boxes, sensor_height_m)


def _labelled_part(
    points: npt.NDArray[np.float32],
    boxes: npt.NDArray[np.float32],
    sector_rad: tuple[float, float],
    keep_last_box: bool,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    centre, half_width = sector_rad

    def within(xy: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
        offset = np.arctan2(xy[:, 1], xy[:, 0]) - centre
        inside: npt.NDArray[np.bool_] = np.abs((offset + np.pi) % (2 * np.pi) - np.pi) <= half_width
        return inside

    labelled = within(boxes)
    if keep_last_box:
        labelled[-1:] = True
    on_vehicle = points_in_boxes(points, boxes, MARGIN_M)
    kept = (within(points) | on_vehicle[labelled].any(axis=0)) & ~on_vehicle[~labelled].any(axis=0)
    return points[kept], boxes[labelled]


def cache_scenes(
    folder: Path,
    names: Iterable[str],
    build: Callable[[str], TrainingScene],
    title: str | None = None,
    workers: int = 1,
) -> list[Path]:
    """Return the cache files of the named scenes; build the missing scenes and write them atomically.

    The cache folder is `folder`-DIGEST of the source code: a changed program builds its own scenes.
    title: of a progress bar. workers: processes that build, to the same bytes; for several `build` must be picklable.
    """
    folder = folder.with_name(f"{folder.name}-{program_digest(*_CODE)[:16]}")
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: folder / f"{name.replace('/', '_')}.npz" for name in names}
    missing = {name: file for name, file in files.items() if not file.exists()}
    bar = progress_bar(total=len(missing), desc=title, unit="scene", disable=title is None or not missing)
    with bar:
        for _ in each(partial(_cache, build), list(missing.items()), workers):
            bar.update()
    return list(files.values())


def _cache(build: Callable[[str], TrainingScene], missing: tuple[str, Path]) -> None:
    name, file = missing
    scene = build(name)
    write_arrays(file, points=scene.points, boxes=scene.boxes, height=scene.sensor_height_m)


def load_cached(file: Path) -> TrainingScene:
    """Read one cached scene."""
    with read_arrays(file) as data:
        return TrainingScene(data["points"], data["boxes"], float(data["height"]))
