"""One object in one scene before one detector: everything a loss is a function of."""

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

if TYPE_CHECKING:  # nothing of effects is imported unless a scene calls for one
    from shift3d.effects.chain import EffectChain


@dataclass(frozen=True)
class AttackProblem:
    """What stays fixed during an attack.

    Attributes:
        beams: of the scene without the object. ground_z_m: the scene's.
        field_of: latent code (d,) -> field, such as `Decoder.field`.
        vehicle: frame and size.
        detector: attacked.
        theta0: (6,) float64 start pose. code0: (d,) start code, dtype of the decoder.
        constraints, settings: see there.
        travel_m: how far the object may move.
        kept_share: share of `constraints.min_object_points` that must remain during an attack. The rule is there
            to keep out objects that the scene hides; a shape that shrinks or a pose that backs away loses points
            without being hidden. Our choice: the paper is silent.
        others: (M, 2) centres of the scene's own vehicles, to stay clear of.
        space: `SdfGrid.of` the field of code0, where one is at hand: renderings of code0 get cheaper.
        effects: what happens to beams beyond their first hit; None: nothing does, as in the paper.
        below_ground_m: deepest that the object may reach below the plane of the ground, where between scan lines and in
            shadows there is no point to hold it; 0: only points are asked, as in the paper. Our choice.
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
    kept_share: float = 0.5
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
        """The object's metric field for a code."""
        s = self.settings
        return ObjectField.of(self.field_of(code), self.vehicle, s.dtype, s.batch, s.bfloat16_band_m)

    @property
    def limits(self) -> Constraints:
        """The constraints as they hold during an attack."""
        kept = math.ceil(self.kept_share * self.constraints.min_object_points)  # of one return, one: never none
        return replace(self.constraints, min_object_points=kept)

    def space_for(self, code: Tensor) -> SdfGrid | None:
        """The SDF grid, if it belongs to this code."""
        return self.space if torch.equal(code, self.code0) else None

    def incremental_inference(self) -> IncrementalInference:
        """Incremental inference of the detector wherever an attack may move the object."""
        window = window_around(self.detector, self.theta0, ATTACK_RADIUS_M + self.travel_m)
        assert window is not None
        return incremental_inference(self.detector, window)

    @property
    def cast_beams(self) -> Beams:
        """The beams as they are cast: the rows of a rendering."""
        return self.beams if self.effects is None else self.effects.beams

    def insert(self, code: Tensor, theta: Tensor, warm: WarmStart | None = None) -> Rendering:
        """Render the object of a code (d,) at a pose (6,), effects included. Differentiable w.r.t. both."""
        sdf, space = self.field_of(code), self.space_for(code)
        if self.effects is None:
            return render(self.beams, sdf, theta, self.vehicle, self.settings, warm, space)
        return self.effects.render(sdf, theta, self.settings, warm, space)

    def points_near(self) -> Tensor:
        """(M, 3) original returns that the object can reach wherever it is moved."""
        if not self._near:
            reach = self.travel_m + float(self.size_m.norm()) / 2 + 1.0
            self._near.append(points_near(self.beams, self.theta0, reach))
        return self._near[0]

    def ground_at(self, theta: Tensor) -> GroundPlane | None:
        """The plane of the ground under a pose (6,); None where too little of it is seen."""
        place = _place(theta)
        if place not in self._planes:
            level = float(self.theta0[2] - self.size_m[2] / 2)
            self._planes.clear()  # a search asks again for the place where it is
            self._planes[place] = fit_ground(self.points_near().numpy(), place, level, self._footprint_m)
        return self._planes[place]

    def obstacles_at(self, theta: Tensor) -> Tensor:
        """(M, 3) what the object may not enter at a pose (6,): original returns, and ground between scan lines."""
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
    """The loss of one code and pose. `adversarial` carries the graph back to both.

    proposals: that the loss was taken over. proposal_score: the best of them near the object, before suppression.
    """

    adversarial: Tensor
    proposals: Proposals
    proposal_score: float
    rendering: Rendering
    check: ConstraintCheck
    milliseconds: dict[str, float]

    @property
    def non_finite(self) -> int:
        """NaN and infinities among the moved points, their ranges and the proposals; 0 by construction."""
        answers = self.proposals.boxes, self.proposals.logits
        return self.rendering.non_finite + sum(count_non_finite(part) for part in answers)


def count_non_finite(values: Tensor) -> int:
    """Number of NaN and infinities."""
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

    radius_m: how far around the object proposals are looked at; None: the whole scene, as the paper does.
    incremental: of this problem's detector, to be asked in its place: what an earlier measurement computed is reused.

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
    # Whether the scene hides the object is asked of its first hits: fog is no reason to call a place impossible.
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
