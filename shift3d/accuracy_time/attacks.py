"""What short attacks with a setting reach: how well its gradient descends, which no error of it says."""

from __future__ import annotations

import dataclasses

from shift3d.accuracy_time.cases import Case, problem_of
from shift3d.accuracy_time.settings import Setting
from shift3d.attack.pose import PoseLimits, attack_pose
from shift3d.attack.shape import attack_shape
from shift3d.task.assets import Assets
from shift3d.task.scoring import score_object

__all__ = ["attack_scores"]


def attack_scores(case: Case, assets: Assets, setting: Setting) -> list[float]:
    """Final scores of the best step of an attack on the shape and of one on the pose, `attack_steps` long each.

    Both are the attacks of a task: its lambda, step size and limits, an SDF grid if the setting uses one, and the
    detector in the precision of the search; what they find is scored in the precision of a task's scores.
    """
    spec, steps = case.spec, setting.attack_steps
    problem = problem_of(case, assets, setting.accuracy, grid=True)
    limits = PoseLimits(max_shift_m=spec.attack.max_shift_m, max_tilt_rad=spec.attack.max_tilt_rad)
    steady = spec.attack.selection_window
    found = [
        attack_shape(problem, spec.lambda_ or 0.0, spec.alpha, steps, selection_window=steady),
        attack_pose(problem, spec.alpha, steps, limits, selection_window=steady),
    ]
    scoring = dataclasses.replace(problem, detector=assets.detector_of(spec.detector, setting.score_precision))
    radius_m = spec.attack.detection_radius_m
    scored = [score_object(scoring, best.latent_code, best.theta, radius_m) for best in found]
    return [float(each.answers[scoring.detector.name].score) for each in scored]
