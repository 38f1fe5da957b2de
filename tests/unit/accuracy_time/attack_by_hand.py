"""An attack on a closed-form shape, small enough for a test of a second."""

from __future__ import annotations

import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, ground_scan, in_frame, soft_car
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.problem import AttackProblem
from shift3d.placement.constraints import Constraints
from shift3d.render import Beams, preset

FRAME = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
THETA = torch.tensor([9.0, 2.0, -1.03, 0.4, 0.0, 0.0], dtype=torch.float64)
CODE = torch.tensor([0.1, -0.1, 0.2, 0.3, -0.2, 0.1], dtype=torch.float64)


def field_of(code: Tensor) -> Field:
    return in_frame(soft_car(code), FRAME)


def small_problem(**changes: object) -> AttackProblem:
    """Return a vehicle nine metres away on flat ground, seen by 48 beams; float64."""
    settings = preset("standard").with_(dtype=torch.float64, **changes)
    beams = Beams.from_arrays(*ground_scan(rings=48, columns=600))
    rules = Constraints(min_object_points=50)
    return AttackProblem(beams, -1.73, field_of, FRAME, WaveDetector(), THETA, CODE, rules, settings)
