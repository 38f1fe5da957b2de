"""Adversarial shape: descend on the latent code."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from shift3d.attack.loop import Search, descend
from shift3d.attack.objective import latent_penalty
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord


def attack_shape(
    problem: AttackProblem,
    lambda_: float,
    alpha: float = 0.01,
    steps: int = 40,
    on_step: Callable[[StepRecord], None] | None = None,
) -> AttackResult:
    """min_z L_adv(z) + lambda ||z - z0||^2 at a fixed pose.

    Args:
        problem: scene, object, detector.
        lambda_: weight of the latent distance, >= 0.
        alpha: step size.
        steps: re-renderings after the first.
        on_step: called with every record as it is made.

    Source: SHIFT3D eq. loss_z and Algorithm 1.
    """
    search = Search(
        mode="shape",
        start=problem.code0,
        parameters=lambda code: (code, problem.theta0),
        penalty=lambda code: lambda_ * latent_penalty(code, problem.code0),
        project=_free,
    )
    return descend(problem, search, steps, alpha, on_step)


def _free(code: Tensor) -> Tensor:
    """The shape has no hard constraint: the realism constraints gate which step is kept."""
    return code
