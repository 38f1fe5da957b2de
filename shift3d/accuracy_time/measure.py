"""Measurement of one setting on one case: rendering errors, an attack step's gradient, final scores, and times."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from shift3d.accuracy_time.cases import Case, case_problem
from shift3d.accuracy_time.errors import compare
from shift3d.accuracy_time.gradient import AttackStep, attack_step, cosine, norm_ratio
from shift3d.accuracy_time.settings import Setting
from shift3d.accuracy_time.timing import milliseconds
from shift3d.accuracy_time.truth import Truth, score_of
from shift3d.attack.objective import SCORE_RADIUS_M, to_network_frame, window_around
from shift3d.attack.pose import PoseLimits, attack_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.shape import attack_shape
from shift3d.detectors.incremental.inference import IncrementalInference
from shift3d.geometry.se3 import object_from_scene
from shift3d.render.culling import SPHERE_RADIUS_M, beams_near
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.solvers.search import WarmStart
from shift3d.task.assets import Assets
from shift3d.task.scoring import score_object

Outcome = dict[str, Any]
"""Plain values, ready for JSON."""


@dataclass(frozen=True)
class _Prepared:
    """Inputs to render one shape with one setting. before: previous rendering of a warm setting, and its pose (6,)."""

    problem: AttackProblem
    before: tuple[Rendering, Tensor] | None = None
    incremental: IncrementalInference | None = None

    @property
    def warm(self) -> WarmStart | None:
        return None if self.before is None else self.before[0].warm


@dataclass
class CaseMeasurer:
    """Measurement of settings on one case.

    truth: ground truth of the case. exact: preset that made the truth; its field gives the residual |g|. warm_steps:
    consecutive renderings before the measured warm one. slow_s: a setting with a slower rendering is rendered once.
    """

    case: Case
    assets: Assets
    truth: Truth
    exact: Setting
    warm_steps: int
    slow_s: float
    _prepared: dict[tuple[str, str], _Prepared] = field(default_factory=dict)

    def look(self, setting: Setting) -> Outcome:
        """Measure once: an attack step with its gradient, the errors of the rendering, and the final score."""
        prepared = self._ready(setting, "start")
        step = self._step(setting, prepared)
        slow = step.render_ms > 1e3 * self.slow_s
        # Without gradients the renderer may check hits more closely. The errors must be those of the timed rendering.
        rendering = step.rendering if slow or setting.variable != "no" else self._render(setting, prepared)
        gradients = [(step.dz, self.truth.dz)] if setting.variable != "pose" else []
        gradients += [(step.dtheta, self.truth.dtheta)] if setting.variable != "shape" else []
        return {
            **self._times(step),
            "cosines": [cosine(found, true) for found, true in gradients],
            "norm_ratios": [norm_ratio(found, true) for found, true in gradients],
            **self._outcome(setting, prepared, rendering, "start"),
        }

    def step(self, setting: Setting) -> Outcome:
        """Time one more attack step."""
        return self._times(self._step(setting, self._ready(setting, "start")))

    def displaced(self, setting: Setting) -> Outcome:
        """Measure the errors and the score of the displaced shape."""
        prepared = self._ready(setting, "displaced")
        return self._outcome(setting, prepared, self._render(setting, prepared), "displaced")

    def attack(self, setting: Setting) -> Outcome:
        """Attack the shape and the pose for `attack_steps` steps each; return the final score of each best step.

        Both attacks are those of a task: lambda, step size, limits, an SDF grid if the setting uses one, and the
        detector in the precision of the search. Their solutions are scored in the precision of a task's scores.
        """
        spec, steps = self.case.spec, setting.attack_steps
        problem = case_problem(self.case, self.assets, setting.accuracy, grid=True)
        limits = PoseLimits(max_shift_m=spec.attack.max_shift_m, max_tilt_rad=spec.attack.max_tilt_rad)
        steady, radius_m = spec.attack.selection_window, spec.attack.detection_radius_m
        found = [
            attack_shape(problem, spec.lambda_ or 0.0, spec.alpha, steps, selection_window=steady),
            attack_pose(problem, spec.alpha, steps, limits, selection_window=steady),
        ]
        detector = self.assets.detector_of(spec.detector, setting.score_precision)
        problem = dataclasses.replace(problem, detector=detector)
        scored = [score_object(problem, best.latent_code, best.theta, radius_m) for best in found]
        return {"scores": [float(each.results[detector.name].score) for each in scored]}

    def sample(self, setting: Setting) -> float:
        """Time one rendering, in milliseconds."""
        prepared = self._ready(setting, "start")
        return milliseconds(lambda: self._render(setting, prepared))

    def _ready(self, setting: Setting, shape: str) -> _Prepared:
        key = setting.step_key, shape
        if key not in self._prepared:
            problem = case_problem(self.case, self.assets, setting.accuracy, self.truth.codes[shape], setting.grid)
            before = None if setting.warm == "no" else self._approach(setting, problem)
            incremental = problem.incremental_inference() if before is not None and setting.incremental else None
            self._prepared[key] = _Prepared(problem, before, incremental)
        return self._prepared[key]

    def _approach(self, setting: Setting, problem: AttackProblem) -> tuple[Rendering, Tensor]:
        """Render the steps along the reference gradient before the measured rendering; return the last and its pose."""
        warm: WarmStart | None = None
        for back in range(self.warm_steps, 0, -1):
            away = self.case.spec.alpha * back
            code, theta = problem.code0, problem.theta0
            if setting.warm == "shape":
                code = code + (away * self.truth.dz).to(code.dtype)
            else:
                theta = theta + away * self.truth.dtheta
            before = _rendered(problem, setting, code, theta, warm), theta
            warm = before[0].warm
        return before

    def _render(self, setting: Setting, prepared: _Prepared) -> Rendering:
        problem = prepared.problem
        return _rendered(problem, setting, problem.code0, problem.theta0, prepared.warm)

    def _step(self, setting: Setting, prepared: _Prepared) -> AttackStep:
        problem, incremental = prepared.problem, prepared.incremental
        if prepared.before is not None and incremental is not None:
            with torch.no_grad():
                rendering, theta = prepared.before
                points = to_network_frame(rendering.points.detach(), problem.ground_z_m)
                incremental.proposals(
                    points, window_around(problem.detector, theta, setting.crop_m), rendering.hit_mask
                )
        of_code, of_pose = setting.variable != "pose", setting.variable != "shape"
        code, theta = problem.code0, problem.theta0
        return attack_step(problem, code, theta, setting.crop_m, prepared.warm, of_code, of_pose, incremental)

    def _times(self, step: AttackStep) -> Outcome:
        return {"render_ms": step.render_ms, "detector_ms": step.detector_ms, "step_ms": step.total_ms}

    def _outcome(self, setting: Setting, prepared: _Prepared, rendering: Rendering, shape: str) -> Outcome:
        problem = prepared.problem
        near = beams_near(problem.beams, problem.theta0[:3], SPHERE_RADIUS_M)
        detector = self.assets.detector_of(self.case.spec.detector, setting.score_precision)
        window_m = None if setting.crop_m is None else SCORE_RADIUS_M
        score = score_of(problem, detector, rendering, window_m, self.case.spec.attack.detection_radius_m)
        return {
            **compare(self.truth.hits[shape], rendering),
            "residual_m": self._residual(rendering, shape),
            "evaluations": rendering.evaluations,
            "ball_beams": len(near),
            "unresolved": rendering.unresolved_beams,
            "score": score,
            "true_score": self.truth.scores[shape],
        }

    @torch.no_grad()
    def _residual(self, rendering: Rendering, shape: str) -> float:
        """Compute the largest |g| at a hit, by the reference's float64 field, not in the setting's precision."""
        key = "exact", shape
        if key not in self._prepared:
            problem = case_problem(self.case, self.assets, self.exact.accuracy, self.truth.codes[shape])
            self._prepared[key] = _Prepared(problem)
        problem = self._prepared[key].problem
        if rendering.object_points == 0:
            return 0.0
        index, beams = torch.nonzero(rendering.hit_mask).squeeze(1), problem.beams
        points = beams.origins[index] + rendering.range_m[index][:, None] * beams.directions[index]
        at_hits = problem.metric(problem.code0)(object_from_scene(points, problem.theta0))
        return float(at_hits.abs().max())


def _rendered(
    problem: AttackProblem, setting: Setting, code: Tensor, theta: Tensor, warm: WarmStart | None
) -> Rendering:
    """Render with everything that the gradient of the setting's variable needs, or without a gradient."""
    code = code.detach().clone().requires_grad_(setting.variable == "shape")
    theta = theta.detach().clone().requires_grad_(setting.variable == "pose")
    with torch.set_grad_enabled(setting.variable != "no"):
        sdf = problem.field_of(code)
        grid = problem.sdf_grid_for(code)
        return render(problem.beams, sdf, theta, problem.vehicle, problem.settings, warm, grid)
