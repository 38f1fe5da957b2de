"""Adversarial shape: a search over latent codes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from torch import Tensor

from shift3d.attack.loop import descend
from shift3d.attack.objective import latent_penalty
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.attack.space import CodeSpace, free_space
from shift3d.attack.trials import OtherPlace, Search
from shift3d.placement.constraints import snap_to_ground

SNAP_M = 0.35
"""Largest change of the height by which a shape follows the ground, metres. Our choice, see `shape_search`."""


def shape_search(
    problem: AttackProblem,
    lambda_: float,
    space: CodeSpace | None = None,
    snap_m: float = SNAP_M,
    elsewhere: Sequence[AttackProblem] = (),
) -> Search:
    """Define min_z L_adv(z) + lambda ||z - z0||^2 at a fixed pose.

    Args:
        problem: scene, object, detector. lambda_: weight of the latent distance, >= 0.
        space: allowed codes; None: all codes.
        snap_m: largest change of the height by which the object stays on the ground as its shape changes; 0: the pose
            is fixed.
        elsewhere: the same vehicle in other scenes. If given, L_adv is the mean over all scenes: the shape is a
            universal one. The constraints are those of `problem` alone.
    Source: SHIFT3D eq. loss_z. The height is our choice: a wheel base that rises by 2 cm would leave the object in the
    air and end the search; a real vehicle of that shape would be lower.
    """
    space = space or free_space(problem.code0)

    def parameters(u: Tensor) -> tuple[Tensor, Tensor]:
        code = space.code(u)
        return code, on_ground(code, problem, snap_m)

    return Search(
        start=space.start,
        parameters=parameters,
        # lambda 0 needs its own case, because an infinite penalty times 0 is NaN.
        penalty=lambda u: lambda_ * latent_penalty(space.code(u), problem.code0) if lambda_ else u.new_zeros(()),
        project=space.project,
        draw=space.draw,
        elsewhere=tuple(OtherPlace(other, partial(on_ground, problem=other, snap_m=snap_m)) for other in elsewhere),
    )


def attack_shape(
    problem: AttackProblem,
    lambda_: float,
    alpha: float = 0.01,
    steps: int = 40,
    snap_m: float = SNAP_M,
    on_step: Callable[[StepRecord], None] | None = None,
    selection_window: int = 0,
) -> AttackResult:
    """Run the paper's adversarial shape attack: plain descent on `shape_search` over every code.

    alpha: step size. steps: re-renderings after the first. on_step: called with each new record. selection_window: rule
    for the kept step, see `shift3d.attack.loop.best_step`.
    Source: SHIFT3D eq. loss_z and Algorithm 1.
    """
    return descend(problem, shape_search(problem, lambda_, snap_m=snap_m), steps, alpha, on_step, selection_window)


def on_ground(code: Tensor, problem: AttackProblem, snap_m: float) -> Tensor:
    """Return theta0 (6,) with the height at which a code's shape is on the ground; theta0 if no ground is in reach."""
    start = problem.theta0
    if snap_m == 0:
        return start
    found = snap_to_ground(problem.metric(code.detach()), problem.obstacles_at(start), start, problem.size_m, snap_m)
    return start if found is None else found
