"""Attack problem: one object in one scene for one detector, with all inputs of the loss."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.objective import (
    ATTACK_RADIUS_M,
    adversarial_loss,
    object_box,
    proposal_score,
    to_network_frame,
    window_around,
)
from shift3d.detectors.base import Detector, Proposals
from shift3d.detectors.incremental.inference import IncrementalInference, incremental_inference
from shift3d.placement.constraints import PAPER_CONSTRAINTS, ConstraintCheck, Constraints, check, points_near
from shift3d.placement.ground import GroundPlane, fit_ground
from shift3d.render.beams import Beams
from shift3d.render.field.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.render.solvers.search import WarmStart

if TYPE_CHECKING:  # effects are imported only for scenes that use one
    from shift3d.effects.chain import EffectChain


@dataclass(frozen=True)
class AttackProblem:
    """Everything that stays fixed during an attack.

    Attributes:
        beams: of the scene without the object. ground_z_m: the scene's.
        field_of: latent code (d,) -> field, such as `Decoder.field`.
        vehicle: frame and size. detector: the attacked detector.
        theta0: (6,) float64 start pose. code0: (d,) start code, dtype of the decoder.
        constraints, settings: see their classes.
        travel_m: largest distance that the object may move.
        others: (M, 2) centres of the scene's own vehicles, from which the object keeps clear.
        space: `SdfGrid.of` the field of code0, if available: renderings of code0 get cheaper.
        effects: changes of beams beyond their first hit; None: no effects, as in the paper.
        below_ground_m: largest depth of the object below the ground plane between scan lines and in shadows, where no
            point limits it; 0: only points limit the object, as in the paper. Our choice.
    """

    beams: Beams
    ground_z_m: float
    field_of: Callable[[Tensor], Field]
    vehicle: VehicleFrame
    detector: Detector
    theta0: Tensor
    code0: Tensor
    constraints: Constraints = PAPER_CONSTRAINTS
    settings: RenderSettings = STANDARD
    travel_m: float = 4.0
    others: Tensor | None = None
    space: SdfGrid | None = None
    effects: EffectChain | None = None
    below_ground_m: float = 0.0
    _near: list[Tensor] = field(default_factory=list, repr=False)
    _planes: dict[tuple[float, float], GroundPlane | None] = field(default_factory=dict, repr=False)

    @property
    def size_m(self) -> Tensor:
        """(3,) float64 size of the baseline's box."""
        return torch.as_tensor(np.asarray(self.vehicle.size_m, dtype=np.float64))

    def metric(self, code: Tensor) -> ObjectField:
        """Return the object's metric field for a code."""
        s = self.settings
        return ObjectField.of(self.field_of(code), self.vehicle, s.dtype, s.batch, s.bfloat16_band_m)

    @property
    def limits(self) -> Constraints:
        """Constraints that hold during an attack: half of the points must remain.

        `constraints.min_object_points` excludes objects that the scene hides; a shape that shrinks or a pose that moves
        away loses points without being hidden. Our choice: the paper is silent.
        """
        kept = math.ceil(0.5 * self.constraints.min_object_points)  # rounded up: one return stays one
        return replace(self.constraints, min_object_points=kept)

    def sdf_grid_for(self, code: Tensor) -> SdfGrid | None:
        """Return the SDF grid if it belongs to this code, else None."""
        return self.space if torch.equal(code, self.code0) else None

    def incremental_inference(self) -> IncrementalInference:
        """Create the detector's incremental inference for all places that an attack can move the object to."""
        window = window_around(self.detector, self.theta0, ATTACK_RADIUS_M + self.travel_m)
        assert window is not None
        return incremental_inference(self.detector, window)

    @property
    def cast_beams(self) -> Beams:
        """Beams that are cast: the rows of a rendering."""
        return self.beams if self.effects is None else self.effects.beams

    def insert(self, code: Tensor, theta: Tensor, warm: WarmStart | None = None) -> Rendering:
        """Render the object of a code (d,) at a pose (6,) with effects. Differentiable w.r.t. both."""
        sdf, space = self.field_of(code), self.sdf_grid_for(code)
        if self.effects is None:
            return render(self.beams, sdf, theta, self.vehicle, self.settings, warm, space)
        return self.effects.render(sdf, theta, self.settings, warm, space)

    def points_near(self) -> Tensor:
        """Return (M, 3) original returns that the object can reach during an attack."""
        if not self._near:
            reach = self.travel_m + float(self.size_m.norm()) / 2 + 1.0
            self._near.append(points_near(self.beams, self.theta0, reach))
        return self._near[0]

    def ground_at(self, theta: Tensor) -> GroundPlane | None:
        """Fit the ground plane under a pose (6,); None if too little ground is visible."""
        place = _place(theta)
        if place not in self._planes:
            level = float(self.theta0[2] - self.size_m[2] / 2)
            self._planes.clear()  # a search asks repeatedly for its current place only
            self._planes[place] = fit_ground(self.points_near().numpy(), place, level, self._footprint_m)
        return self._planes[place]

    def obstacles_at(self, theta: Tensor) -> Tensor:
        """Return (M, 3) points that the object may not enter at a pose (6,): returns, and ground between scan lines."""
        plane = self.ground_at(theta) if self.below_ground_m and bool(torch.isfinite(theta).all()) else None
        if plane is None:
            return self.points_near()
        ground = plane.lowered(_place(theta), self._footprint_m, self.below_ground_m)
        return torch.cat((self.points_near(), torch.from_numpy(ground)))

    @property
    def _footprint_m(self) -> float:
        return float(self.size_m[:2].norm()) / 2 + 0.5


def _place(theta: Tensor) -> tuple[float, float]:
    x, y = theta[:2].detach().tolist()
    return x, y


@dataclass(frozen=True)
class Measurement:
    """The loss of one code and pose. `adversarial` carries the graph to both.

    proposals: input of the loss. proposal_score: highest score of a proposal near the object, before suppression.
    """

    adversarial: Tensor
    proposals: Proposals
    proposal_score: float
    rendering: Rendering
    check: ConstraintCheck
    milliseconds: dict[str, float]

    @property
    def non_finite(self) -> int:
        """Number of NaN and infinities in the moved points, their ranges and the proposals; 0 by construction."""
        answers = self.proposals.boxes, self.proposals.logits
        return self.rendering.non_finite + sum(count_non_finite(part) for part in answers)


def count_non_finite(values: Tensor) -> int:
    """Count NaN and infinities."""
    return int((~torch.isfinite(values.detach())).sum())


def measure(
    problem: AttackProblem,
    code: Tensor,
    theta: Tensor,
    warm: WarmStart | None = None,
    radius_m: float | None = ATTACK_RADIUS_M,
    incremental: IncrementalInference | None = None,
) -> Measurement:
    """Render, detect, and check the constraints.

    radius_m: radius around the object within which proposals count; None: the whole scene, as in the paper.
    incremental: incremental inference of the problem's detector, used in its place; it reuses earlier computations.
    Differentiable w.r.t. code and theta, through `adversarial`. Source: SHIFT3D, Algorithm 1.
    """
    start = time.perf_counter()
    rendering = problem.insert(code, theta, warm)
    rendered = time.perf_counter()
    points = to_network_frame(rendering.points, problem.ground_z_m)
    window = window_around(problem.detector, theta, radius_m)
    if incremental is None or window is None:
        proposals = problem.detector.proposals(points, window)
    else:
        proposals = incremental.proposals(points, window, requires_grad=rendering.hit_mask)
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
    loss = adversarial_loss(proposals, box)
    score = proposal_score(proposals, box)
    detected = time.perf_counter()
    # First hits decide whether the scene hides the object: fog does not make a place invalid.
    seen = rendering.first_hits.object_points
    metric, obstacles, around = problem.metric(code), problem.obstacles_at(theta), rendering.first_hits.box
    held = check(metric, obstacles, theta, problem.size_m, seen, problem.limits, problem.others, around)
    by_effect = {f"effect_{name}": spent for name, spent in rendering.milliseconds.items()}
    spent = {
        "render": 1e3 * (rendered - start) - sum(by_effect.values()),
        **by_effect,
        "detector": 1e3 * (detected - rendered),
        "constraints": 1e3 * (time.perf_counter() - detected),
    }
    return Measurement(loss, proposals, score, rendering, held, spent)
