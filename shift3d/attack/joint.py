"""Attack on shape and pose together."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.objective import latent_penalty
from shift3d.attack.pose import PoseLimits, draw_pose, project, snap_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.space import CodeSpace
from shift3d.attack.trials import Search


def joint_search(problem: AttackProblem, lambda_: float, space: CodeSpace, limits: PoseLimits) -> Search:
    """Define min over z and theta of L_adv(z, theta) + lambda ||z - z0||^2, theta in B(theta0).

    The variable holds the space's coordinates, then the pose. Source: our choice: the paper searches one at a time.
    """
    count = len(space.start)

    def parts(v: Tensor) -> tuple[Tensor, Tensor]:
        return space.code(v[:count].to(space.start.dtype)), v[count:]

    def projected(v: Tensor) -> Tensor:
        if not bool(torch.isfinite(v).all()):
            return v
        u = space.project(v[:count])
        code = space.code(u.to(space.start.dtype)).detach()
        if not bool(torch.isfinite(code).all()):  # coordinates are float64, and a code may be float32
            return torch.full_like(v, torch.inf)
        metric = problem.metric(code)
        theta = snap_pose(project(v[count:], problem.theta0, limits), problem, metric, limits)
        return torch.cat([u.double(), theta])

    def draw(rng: np.random.Generator, distance: float) -> Tensor:
        return projected(torch.cat([space.draw(rng, distance).double(), draw_pose(problem.theta0, rng, limits)]))

    return Search(
        start=torch.cat([space.start.double(), problem.theta0.double()]),
        parameters=parts,
        penalty=lambda v: lambda_ * latent_penalty(parts(v)[0], problem.code0) if lambda_ else v.new_zeros(()),
        project=projected,
        draw=draw,
    )
