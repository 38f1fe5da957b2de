"""Survey of a scene: positions where a vehicle could be placed, and reasons why others are rejected."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import PlacementContext, PlacementLimits, draw_position, format_refusals, pose_on_ground
from shift3d.render.culling import clip_to_box, object_rays

CAR_SIZE_M = (4.5, 1.8, 1.5)
FREE = "free"


@dataclass(frozen=True)
class Survey:
    """Tested positions xy_m (N, 2), scene frame, and the outcome of each: "free" or a key of `sampling.REFUSALS`."""

    xy_m: NDArray[np.float64]
    outcomes: tuple[str, ...]

    @property
    def free(self) -> NDArray[np.bool_]:
        """Mask (N,) of positions where a vehicle could be placed."""
        return np.array([outcome == FREE for outcome in self.outcomes])

    @property
    def lacks_ground(self) -> bool:
        """True if most positions are rejected because no ground is visible."""
        return 2 * self.outcomes.count("ground") > len(self.outcomes)

    def line(self) -> str:
        """Format the number of free positions and the count of each reason."""
        counts = Counter(self.outcomes)
        refused = format_refusals({name: count for name, count in counts.items() if name != FREE})
        return f"{counts[FREE]} of {len(self.outcomes)} free" + (f"; {refused}" if refused else "")


def survey(site: PlacementContext, limits: PlacementLimits, constraints: Constraints) -> Survey:
    """Test `limits.attempts` positions with the tests of `sampling.place` that need no rendering.

    `place` may still reject a free position for a shape: the shape may touch nothing, overlap something, or get fewer
    points than there are beams through its box. Deterministic. Source: our choice.
    """
    size, whole = torch.tensor(CAR_SIZE_M, dtype=torch.float64), replace(limits, attempts=1)
    rng, places, outcomes = np.random.default_rng(0), [], []
    for _ in range(limits.attempts):
        draw = draw_position(rng, whole, 1)
        places.append(draw[:2])
        on_ground = pose_on_ground(draw, site, size, constraints)
        outcome = on_ground if isinstance(on_ground, str) else FREE
        if outcome == "points" and _aimed(site, draw, size) >= constraints.min_object_points:
            outcome = "hidden"
        outcomes.append(outcome)
    return Survey(np.array(places), tuple(outcomes))


def _aimed(site: PlacementContext, draw: tuple[float, float, float], size: Tensor) -> int:
    """Count the beams that would hit the box if nothing occluded it."""
    x, y, yaw = draw
    theta = torch.tensor([x, y, site.ground_at(x, y) + float(size[2]) / 2, yaw, 0.0, 0.0], dtype=torch.float64)
    rays = object_rays(site.beams, torch.nonzero(site.beams.carries).squeeze(1), theta)
    endless = replace(rays, far_m=torch.full_like(rays.far_m, float("inf")))
    return len(clip_to_box(endless, -size / 2, size / 2))
