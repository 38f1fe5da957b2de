"""Results of an attack: a record for each step, and the kept solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from torch import Tensor

from shift3d.placement.constraints import ConstraintCheck
from shift3d.render.field.object_field import VehicleFrame


@dataclass(frozen=True)
class StepRecord:
    """One rendering of an attack; step 0 is the start.

    theta: (6,) pose. latent_distance: from the code of the start. loss: the descended value, the mean over all places
    of the search. adversarial_loss: L_adv at theta alone. proposal_score: best score near the object before
    suppression. grazing_gradient: share of grazing beams in the gradient that leads from this step to the next; None if
    no gradient was taken (last step). least_slope: smallest |e . grad g| of this step's hits; infinite without hits,
    and in searches without gradients. non_finite: NaN and infinities among the moved points, the proposals, the loss
    and the gradient; 0 by construction. within_budget: False for a shape beyond the budget of naturalness, see
    `trials.Search.natural`. is_start: True for step 0, and whenever its object is evaluated again. milliseconds: by
    stage (placement, render, detector, constraints, backward, naturalness), summed over all places in the mean loss.
    """

    step: int
    theta: tuple[float, ...]
    latent_distance: float
    loss: float
    adversarial_loss: float
    proposal_score: float
    check: ConstraintCheck
    unresolved_beams: int
    max_residual_m: float
    evaluations: int
    grazing_gradient: float | None = None
    least_slope: float = math.inf
    non_finite: int = 0
    within_budget: bool = True
    is_start: bool = False
    milliseconds: dict[str, float] = field(default_factory=dict)

    @property
    def valid(self) -> bool:
        """True if all constraints hold and the shape is not known to lie beyond the budget."""
        return self.check.valid and self.within_budget


@dataclass(frozen=True)
class AttackResult:
    """The best valid step, or the start if no step was valid.

    vehicle: vehicle whose object frame renders the code. latent_code: (d,). theta: (6,) float64. best_step: 1..steps,
    or 0 if no step was valid and the baseline is kept. status: "ok"; "no_valid_step"; "diverged" if a step was not
    finite (the search ended there, earlier steps count). trace: one record per rendering, step 0 first.
    """

    vehicle: VehicleFrame
    latent_code: Tensor
    theta: Tensor
    best_step: int
    status: str
    trace: tuple[StepRecord, ...]

    @property
    def best(self) -> StepRecord:
        """Record of the kept step."""
        return self.trace[self.best_step]

    def milliseconds(self) -> dict[str, float]:
        """Sum the time of all steps by stage."""
        total: dict[str, float] = {}
        for record in self.trace:
            for stage, value in record.milliseconds.items():
                total[stage] = total.get(stage, 0.0) + value
        return total
