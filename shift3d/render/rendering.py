"""Results of the renderer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from shift3d.render.culling import Box
    from shift3d.render.solvers.search import WarmStart


@dataclass
class GrazingShare:
    """Measures of how close the hits are to the silhouette and how much of the gradient ran through grazing hits.

    Attributes:
        beams: number of hits with |e . grad g| below `min_n_dot_d` (grazing hits).
        gradient: share in [0, 1] of the grazing hits in sum_i |e_i . dL/dx_i| / max(|e_i . grad g|, floor) of the last
            backward pass; 0 before a backward pass and if no gradient flows.
        cosine: (M,) float64 |cosine| of incidence at every hit, in row order; None if no gradient was wanted.
        least_slope: smallest |e . grad g| of all hits; infinite without hits, and if no gradient was wanted.
    """

    beams: int = 0
    gradient: float = 0.0
    least_slope: float = math.inf
    cosine: Tensor | None = None


@dataclass(frozen=True)
class Rendering:
    """A scene with the object in it.

    Attributes:
        points: (N, 3) scene frame, metres, dtype and order of the scene's points. Points of beams without a hit are the
            scene's own, bit for bit. Differentiable w.r.t. the pose and the latent code if these require gradients.
        hit_mask: (N,) bool, m_i of the paper: points on the object.
        range_m: (N,) float64 range of each rendered return from its beam's own sensor; carries no gradient.
        max_residual_m: largest |metric g| at a hit; 0 without hits.
        unresolved_beams: number of beams that could not be decided; their points stay where they were.
        evaluations: points at which the field was evaluated (the gradient's evaluations not included).
        coarse_evaluations: number of these evaluations in bfloat16 alone.
        grazing: share of the gradient on grazing beams, filled in by the backward pass.
        warm: starting point of the next rendering, see `render`.
        returned: (N,) bool, rows with a return; None: all rows. The other rows are placed `NO_RETURN_M` out.
        core: the rendering before effects changed it; None without effects.
        reflectance: (N,) float64 in [0, 1] if an effect computed it.
        milliseconds: time of each effect, by name.
    """

    points: Tensor
    hit_mask: Tensor
    range_m: Tensor
    max_residual_m: float
    unresolved_beams: int
    evaluations: int
    coarse_evaluations: int = 0
    grazing: GrazingShare = field(default_factory=GrazingShare)
    warm: WarmStart | None = None
    returned: Tensor | None = None
    core: Rendering | None = None
    reflectance: Tensor | None = None
    milliseconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def first_hits(self) -> Rendering:
        """The rendering before effects."""
        return self.core or self

    @property
    def box(self) -> Box | None:
        """Verified box of the object, object frame; None if the search made none."""
        return None if self.warm is None or self.warm.box is None else self.warm.box.box

    @property
    def object_points(self) -> int:
        """Number of points on the object."""
        return int(self.hit_mask.sum())

    @property
    def non_finite(self) -> int:
        """Number of non-finite coordinates and ranges among the points on the object: 0 by construction."""
        moved = self.points.detach()[self.hit_mask], self.range_m.detach()[self.hit_mask]
        return sum(int((~torch.isfinite(part)).sum()) for part in moved)
