"""Models of both codebases, each as a config and as the plain arithmetic that the config stands for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from pathlib import Path

import torch
from foreign_configs import (
    KITTI_RANGE,
    WIDE_RANGE,
    mm_centerpoint,
    mm_hard,
    mm_pointpillars,
    pcd_centerpoint_nuscenes,
    pcd_centerpoint_waymo,
    pcd_coarse,
    pcd_pointpillar,
)
from foreign_sources import Anchors, Centres, Pillars, Source

from shift3d.detectors.foreign.config_common import ForeignOverrides
from shift3d.detectors.foreign.detector import NO_OVERRIDES, ForeignDetector, foreign_layout, load_foreign
from shift3d.detectors.models.network import Precision

CAR, WALKER, CYCLIST = (3.9, 1.6, 1.56), (0.8, 0.6, 1.73), (1.76, 0.6, 1.73)


@dataclass(frozen=True)
class Case:
    """Model. height_m, turned: the model's frame. key: name under which a trainer saves the state."""

    name: str
    write: Callable[[Path], Path]
    source: Callable[[], Source]
    height_m: float
    turned: bool
    key: str
    choices: ForeignOverrides = NO_OVERRIDES

    def saved(self, folder: Path) -> tuple[Path, Path]:
        """Write config and checkpoint into a folder."""
        state = {name: value.float() if value.is_floating_point() else value for name, value in self.state().items()}
        torch.save({self.key: state, "epoch": 80, "meta": {"mmdet3d_version": "1.4.0"}}, folder / "model.pth")
        return self.write(folder), folder / "model.pth"

    def state(self) -> dict[str, torch.Tensor]:
        """Return the model's tensors by the codebase's names."""
        return self.source().model.state_dict()

    def detector(self, folder: Path, precision: Precision = "float64") -> ForeignDetector:
        """Load the model with shift3d."""
        config, weights = self.saved(folder)
        return load_foreign(foreign_layout(self.name.split("-")[0], config, self.choices), weights, precision)

    def to_model(self, points: torch.Tensor) -> torch.Tensor:
        """Transform points from the network frame to the model's frame."""
        x, y, z = points.unbind(1)
        x, y = (-y, x) if self.turned else (x, y)
        return torch.stack((x, y, z - self.height_m), dim=1)

    def from_model(self, boxes: torch.Tensor) -> torch.Tensor:
        """Transform boxes from the model's frame to the network frame."""
        result = boxes.clone()
        if self.turned:
            result[:, 0], result[:, 1], result[:, 6] = boxes[:, 1], -boxes[:, 0], boxes[:, 6] - pi / 2
        result[:, 2] += self.height_m
        return result


def _pcd_anchors(aligned: bool, cell_m: float = 0.8) -> Anchors:
    step = cell_m if aligned else 12.8 / 15
    first = cell_m / 2 if aligned else 0.0
    starts = [(first, -6.4 + first, bottom) for bottom in (-1.78, -0.6, -0.6)]
    return Anchors(3, 0, 0.78539, (CAR, WALKER, CYCLIST), starts, (step, step))


def _mm_anchors() -> Anchors:
    starts = [(0.4, -6.0, bottom) for bottom in (-0.6, -0.6, -1.78)]
    return Anchors(3, 2, -pi / 2, (WALKER, CYCLIST, CAR), starts, (0.8, 0.8))


KITTI = Pillars(KITTI_RANGE, (0.4, 0.4, 4), (0.27,), (8,), 32)
CASES = {
    case.name: case
    for case in (
        Case(
            "openpcdet-pointpillar", pcd_pointpillar,
            lambda: Source(True, KITTI, (2, 2, 2), (1, 2, 4), _pcd_anchors(False)), 1.73, False, "model_state",
        ),
        Case(
            "openpcdet-aligned", lambda folder: pcd_pointpillar(folder, aligned=True),
            lambda: Source(True, KITTI, (2, 2, 2), (1, 2, 4), _pcd_anchors(True)), 1.73, False, "model_state",
        ),
        Case(
            "openpcdet-coarse", pcd_coarse,
            lambda: Source(True, KITTI, (1, 1, 2), (0.25, 0.25, 0.5), _pcd_anchors(True, 1.6)), 1.73, False,
            "model_state",
        ),
        Case(
            "openpcdet-centerpoint", pcd_centerpoint_waymo,
            lambda: Source(
                True, Pillars(WIDE_RANGE, (0.4, 0.4, 8), (0.4, 0.0), (8, 8), 20), (1, 2, 2), (1, 2, 4),
                Centres((3,), 0, 1, 6, 6, True, False, 1),
            ), 0.0, False, "model_state", ForeignOverrides(intensity=0.4),
        ),
        Case(
            "openpcdet-dynamic", pcd_centerpoint_nuscenes,
            lambda: Source(
                True, Pillars(WIDE_RANGE, (0.4, 0.4, 8), (12.0, 0.0), (8,), None), (2, 2, 2), (0.5, 1, 2),
                Centres((1, 2), 1, 1, 6, 6, False, True, 4),
            ), 1.84, True, "model_state",
        ),
        Case(
            "mmdet3d-pointpillars", mm_pointpillars,
            lambda: Source(
                False, Pillars(KITTI_RANGE, (0.4, 0.4, 4), (0.27,), (8,), 32, legacy=True), (2, 2, 2), (1, 2, 4),
                _mm_anchors(),
            ), 1.73, False, "state_dict",
        ),
        Case(
            "mmdet3d-hard", mm_hard,
            lambda: Source(
                False, Pillars(WIDE_RANGE, (0.4, 0.4, 8), (0.0,), (6, 8), 20, hard=True), (2, 2, 2), (1, 2, 4),
                Anchors(3, 2, -0.7854, (WALKER, CYCLIST, CAR), [(-6.0, -6.0, -1.8)] * 3, (0.8, 0.8), 9), "pts_",
            ), 1.84, True, "state_dict",
        ),
        Case(
            "mmdet3d-centerpoint", mm_centerpoint,
            lambda: Source(
                False, Pillars(WIDE_RANGE, (0.4, 0.4, 8), (12.0, 0.0), (8,), 20), (2, 2, 2), (0.5, 1, 2),
                Centres((2, 2), 1, 1, 64, 64, False, True, 4), "pts_", True,
            ), 1.84, True, "state_dict",
        ),
    )
}  # fmt: skip


def scene(case: Case, count: int = 250, crowded: int = 25) -> torch.Tensor:
    """Make points (N, 3) float64 over the model's range and a bit beyond, network frame; some pillars nearly full."""
    draw = torch.Generator().manual_seed(5)
    bounds = torch.tensor(WIDE_RANGE if case.turned or case.height_m == 0 else KITTI_RANGE, dtype=torch.float64)
    low, high = bounds[:3] - 0.5, bounds[3:] + 0.5
    points = low + (high - low) * torch.rand(count, 3, generator=draw, dtype=torch.float64)
    cluster = torch.rand(crowded, 3, generator=draw, dtype=torch.float64) * 0.9 + torch.tensor([3.1, 1.1, -1.0])
    x, y, z = torch.cat((points, cluster)).unbind(1)
    x, y = (y, -x) if case.turned else (x, y)
    return torch.stack((x, y, z + case.height_m), dim=1)


def far(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write config and checkpoint of a WIDE_RANGE case with pillars eight times as large: 51.2 m to each side."""
    config, weights = case.saved(folder)
    for file in [*folder.rglob("*.py"), *folder.rglob("*.yaml")]:
        text = file.read_text().replace("-6.4, -6.4", "-51.2, -51.2").replace("6.4, 6.4", "51.2, 51.2")
        file.write_text(text.replace("0.4, 0.4, 8", "3.2, 3.2, 8"))
    return config, weights
