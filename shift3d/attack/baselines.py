"""What an attack is compared with: random changes of the same size."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.pose import PAPER_LIMITS, PoseLimits, drawn_pose, snapped
from shift3d.attack.problem import AttackProblem
from shift3d.placement.constraints import check

_ATTEMPTS = 60


def random_direction(dimension: int, rng: np.random.Generator) -> np.ndarray:
    """(dimension,) unit vector, uniform on the sphere."""
    while True:
        vector = rng.standard_normal(dimension)
        length = float(np.linalg.norm(vector))
        if length > 0:
            return np.asarray(vector / length)


def random_code(baseline_code: Tensor, radius: float, rng: np.random.Generator) -> Tensor:
    """A code (d,) on the sphere of the adversarial code's radius around z0, in the dtype of z0.

    Source: SHIFT3D, Adversarial Shape Generation Results (random shapes at the same latent distance).
    """
    direction = torch.as_tensor(random_direction(len(baseline_code), rng), dtype=torch.float64)
    return (baseline_code.detach().double() + radius * direction).to(baseline_code.dtype)


def noise_codes(code: Tensor, sigma: float, count: int, rng: np.random.Generator) -> Tensor:
    """(count, d) codes z + N(0, sigma^2 I): is the adversarial shape a region or a needle?

    Source: SHIFT3D, Adversarial Shape Generation Results; 10 codes with sigma 0.01.
    """
    noise = torch.as_tensor(rng.standard_normal((count, len(code))) * sigma, dtype=torch.float64)
    return (code.detach().double() + noise).to(code.dtype)


def random_pose(problem: AttackProblem, rng: np.random.Generator, limits: PoseLimits = PAPER_LIMITS) -> Tensor | None:
    """A random pose (6,) from the attack's own feasible set; None if no draw is valid.

    Shift uniform in the disc, yaw uniform, pitch and roll uniform in the limits, z on the ground, and drawn
    again until the realism constraints hold.

    Source: SHIFT3D, Adversarial Pose Generation Results ("random pose perturbations with the same constraints").
    """
    metric = problem.metric(problem.code0.detach())
    for _ in range(_ATTEMPTS):
        theta = snapped(drawn_pose(problem.theta0, rng, limits), problem, metric, limits)
        held = check(metric, problem.obstacles_at(theta), theta, problem.size_m, 0, problem.limits, problem.others)
        if not (held.overlap_ok and held.contact_ok and held.clear_ok):
            continue
        with torch.no_grad():
            rendering = problem.insert(problem.code0.detach(), theta).first_hits
        if rendering.object_points >= problem.limits.min_object_points:
            return theta
    return None
