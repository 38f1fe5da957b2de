"""Timed steps of an attack: the standard preset's inside the loop that tasks run, and those of the published method."""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from benchmarks.timing import Timing

from shift3d.attack.objective import adversarial_loss, object_box, to_network_frame
from shift3d.attack.pose import attack_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import StepRecord
from shift3d.attack.shape import attack_shape
from shift3d.placement.constraints import check
from shift3d.render import Rendering, SdfGrid, render

__all__ = ["MODES", "AttackLoops", "Loop", "cold_rendering", "published_step"]

MODES = ("shape", "pose")


@dataclass
class Loop:
    """Steps of attacks in one mode, without the first and the last step of each attack.

    The first step has no warm start, the last takes no gradient. wall_ms: from one record to the next, including
    everything that belongs to a step. records: of the same steps.
    """

    wall_ms: list[float] = field(default_factory=list)
    records: list[StepRecord] = field(default_factory=list)

    @property
    def step(self) -> Timing:
        """Time of a whole step."""
        return Timing.of(self.wall_ms)

    @property
    def render(self) -> Timing:
        """Time of the rendering in a step."""
        return Timing.of([record.milliseconds["render"] for record in self.records])

    @property
    def evaluations(self) -> float:
        """Median number of the decoder's evaluations in one rendering."""
        return statistics.median(record.evaluations for record in self.records)

    @property
    def hits(self) -> float:
        """Median number of returns on the object."""
        return statistics.median(record.check.object_points for record in self.records)

    def stages(self) -> str:
        """Return medians by stage, for a note."""
        medians = {
            stage: Timing.of([record.milliseconds[stage] for record in self.records]).median
            for stage in self.records[0].milliseconds
        }
        return ", ".join(f"{stage} {median:.0f}" for stage, median in medians.items()) + " ms"


@dataclass
class AttackLoops:
    """Shape and pose attacks on one problem.

    steps: of every attack, at least 2. modes: order in which `run` runs them, reversed every second time.
    """

    problem: AttackProblem
    steps: int
    modes: tuple[str, ...] = MODES
    loops: dict[str, Loop] = field(default_factory=dict)
    _runs: int = 0

    def run(self) -> None:
        """Run one attack in every mode."""
        for mode in self.modes if self._runs % 2 == 0 else self.modes[::-1]:
            records: list[StepRecord] = []
            ends: list[float] = []

            def note(record: StepRecord, records: list[StepRecord] = records, ends: list[float] = ends) -> None:
                records.append(record)
                ends.append(time.perf_counter())

            if mode == "shape":
                attack_shape(self.problem, lambda_=1.0, steps=self.steps, on_step=note)
            else:
                attack_pose(self.problem, steps=self.steps, on_step=note)
            loop = self.loops.setdefault(mode, Loop())
            loop.wall_ms += [1e3 * (b - a) for a, b in itertools.pairwise(ends[:-1])]
            loop.records += records[1:-1]
        self._runs += 1

    def slowest(self, timing: Callable[[Loop], Timing]) -> str:
        """Return the mode that takes longest: a claim about it holds for the others."""
        return max(self.loops, key=lambda mode: timing(self.loops[mode]).median)


@torch.no_grad()
def cold_rendering(problem: AttackProblem, grid: SdfGrid | None = None) -> Rendering:
    """Render the start cold, without gradients, with an SDF grid or without."""
    field = problem.field_of(problem.code0)
    return render(problem.beams, field, problem.theta0, problem.vehicle, problem.settings, None, grid)


def published_step(problem: AttackProblem) -> dict[str, float]:
    """Time one step of the published method: the paper's renderer, the whole scene through the detector, float32.

    problem: with the settings of the paper's renderer. Returns milliseconds by stage, "total" among them.
    """
    marks = [time.perf_counter()]
    code = problem.code0.detach().clone().requires_grad_()
    theta = problem.theta0
    rendering = render(problem.beams, problem.field_of(code), theta, problem.vehicle, problem.settings)
    marks.append(time.perf_counter())
    proposals = problem.detector.proposals(to_network_frame(rendering.points, problem.ground_z_m), None)
    loss = adversarial_loss(proposals, object_box(theta, problem.vehicle.size_m, problem.ground_z_m))
    marks.append(time.perf_counter())
    if loss.requires_grad:
        torch.autograd.grad(loss, code)
    marks.append(time.perf_counter())
    metric = problem.metric(code.detach())
    obstacles, size = problem.obstacles_at(theta), problem.size_m
    check(metric, obstacles, theta, size, rendering.object_points, problem.limits, problem.others)
    marks.append(time.perf_counter())
    stages = ("render", "detector", "backward", "constraints")
    spent = {stage: 1e3 * (b - a) for stage, a, b in zip(stages, marks, marks[1:])}
    return {**spent, "total": 1e3 * (marks[-1] - marks[0])}
