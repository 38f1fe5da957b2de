"""Incremental inference through an attack, against the same detector that evaluates its whole window each step."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import pytest
from benchmarks.results import Results
from benchmarks.steps import AttackLoops, Loop
from benchmarks.timing import Timing
from benchmarks.world import World
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals


@dataclass(frozen=True)
class _Unfollowed:
    """Detector without incremental inference: the plain reference."""

    detector: Detector
    name: str

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        return self.detector.window_for(centre_xy, radius_m)

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        return self.detector.proposals(points, window)

    def detect(
        self,
        points: Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float = 0.25,
    ) -> Detections:
        return self.detector.detect(points, window, score_threshold, iou_threshold)


@pytest.mark.parametrize("name", ["pointpillars", "sst"])
def bench_incremental_forks(bench: Results, world: World, quick: bool, name: str) -> None:
    standard = world.problem()
    precision = standard.detector.precision  # type: ignore[attr-defined]
    detector = world.assets.detector_of(name, precision)
    steps = 4 if quick else 10
    followed, plain = (
        AttackLoops(dataclasses.replace(standard, detector=each), steps)
        for each in (detector, _Unfollowed(detector, name))
    )
    for _ in range(1 if quick else 3):
        plain.run()
        followed.run()
    for mode in followed.modes:
        above, below = plain.loops[mode], followed.loops[mode]
        of = f"{name}, {mode} attack: whole window ms / followed ms"
        bench.ratio(
            f"follow_{name}_{mode}_ratio", _detector(above), _detector(below), f"detector and its gradient, {of}"
        )
        bench.ratio(f"follow_{name}_{mode}_step_ratio", above.step, below.step, f"attack step, {of}", below.stages())


def _detector(loop: Loop) -> Timing:
    """Return detector time, forward and backward; both loops include the renderer's backward pass, a tenth of it."""
    return Timing.of([r.milliseconds["detector"] + r.milliseconds["backward"] for r in loop.records])
