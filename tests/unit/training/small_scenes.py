"""A scene set of a few hundred points each, importable in other processes."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals
from shift3d.errors import InputError
from shift3d.scenes.scene import Labels, Scene
from shift3d.scenes.sets import SceneSet

GROUND_Z_M = -1.73


def small_scene(name: str, seed: int = 0) -> Scene:
    """Return four labels (three vehicles with 50, 5 and 50 points and a pedestrian); the first point has no beam."""
    boxes = np.array(
        [
            [10.0, 5.0, -0.93, 4.5, 1.8, 1.6, 0.3],
            [-20.0, 5.0, -0.93, 4.5, 1.8, 1.6, 2.0],
            [8.0, -5.0, -0.83, 0.8, 0.8, 1.8, 0.0],
            [60.0, 0.0, -0.93, 4.5, 1.8, 1.6, 0.0],
        ]
    )
    rng = np.random.default_rng(seed)
    points = rng.uniform((-40, -40, GROUND_Z_M), (40, 40, 0), (300, 3)).astype(np.float32)
    points[0] = 0.0
    return Scene(
        scene_id=name,
        dataset="small",
        points=points,
        origins=np.zeros_like(points),
        ground_z_m=GROUND_Z_M,
        labels=Labels(boxes, ("vehicle", "vehicle", "pedestrian", "vehicle"), np.array([50, 5, 50, 50], np.int32)),
    )


class SmallScenes:
    """Scenes small-0 to small-4. broken: the last one cannot be read."""

    dataset = "small"
    placement_sector_rad = (0.0, float(np.pi))

    def __init__(self, broken: bool = False) -> None:
        self.broken = broken

    def names(self) -> list[str]:
        return [f"small-{index}" for index in range(5)]

    def load(self, name: str) -> Scene:
        if self.broken and name == "small-4":
            raise InputError("truncated", f"{name}.bin", "Copy it again.")
        return small_scene(name, int(name[-1]))


def open_broken_scenes() -> SceneSet:
    return SmallScenes(broken=True)


class PointDetector:
    """Detector with a car at each of the first 40 points, scored by a sum over all points: quick, unique per scene."""

    name = "points"

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        raise NotImplementedError

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        raise NotImplementedError

    def detect(
        self,
        points: Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float = 0.25,
    ) -> Detections:
        chosen = points[:40]
        scores = torch.sigmoid(torch.sin(chosen @ points.T).sum(dim=1) / 10.0)
        size = torch.tensor([4.5, 1.8, 1.6, 0.0]).expand(len(chosen), 4)
        return Detections(torch.cat((chosen, size), 1).double().numpy(), scores.double().numpy())


def open_point_detector() -> Detector:
    return PointDetector()
