"""Adversarial shape: descend on the latent code."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from shift3d.attack.loop import Search, descend
from shift3d.attack.objective import latent_penalty
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.placement.constraints import snap_to_ground

SNAP_M = 0.35
"""How far a shape's height may follow the ground, metres. Our choice, see `attack_shape`."""


def attack_shape(
    problem: AttackProblem,
    lambda_: float,
    alpha: float = 0.01,
    steps: int = 40,
    snap_m: float = SNAP_M,
    on_step: Callable[[StepRecord], None] | None = None,
    selection_window: int = 0,
) -> AttackResult:
    """min_z L_adv(z) + lambda ||z - z0||^2 at a fixed pose.

    Args:
        problem: scene, object, detector.
        lambda_: weight of the latent distance, >= 0.
        alpha: step size.
        steps: re-renderings after the first.
        snap_m: how far the object's height may follow its shape so that it keeps standing on the ground; 0
            leaves the pose alone.
        on_step: called with every record as it is made.
        selection_window: which step is kept, see `shift3d.attack.loop.best_step`.

    Source: SHIFT3D eq. loss_z and Algorithm 1. The height is our choice: a wheel base that rises by 2 cm would
    leave the object hanging in the air and end the search; a real vehicle of that shape stands lower.
    """
    search = Search(
        mode="shape",
        start=problem.code0,
        parameters=lambda code: (code, on_ground(code, problem, snap_m)),
        # Without lambda there is none, be it infinite: 0 times infinity is NaN.
        penalty=lambda code: lambda_ * latent_penalty(code, problem.code0) if lambda_ else code.new_zeros(()),
        project=_free,
    )
    return descend(problem, search, steps, alpha, on_step, selection_window)


def on_ground(code: Tensor, problem: AttackProblem, snap_m: float) -> Tensor:
    """theta0 (6,) with its height on the ground under the shape of a code; theta0 where there is none in reach."""
    if snap_m == 0:
        return problem.theta0
    found = snap_to_ground(problem.metric(code.detach()), problem.points_near(), problem.theta0, problem.size_m, snap_m)
    return problem.theta0 if found is None else found


def _free(code: Tensor) -> Tensor:
    """The shape has no hard constraint: the realism constraints gate which step is kept."""
    return code
