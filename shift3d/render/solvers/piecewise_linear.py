"""Reference solver: steps over no first crossing as long as the field is no steeper than a bound.

If |grad g| <= `max_slope`, no surface is nearer than g / `max_slope`, so a beam may step that far. Near the surface
such steps would become tiny; there the beam traverses the decoder's linear regions (see `sdf.linear_regions`), in which
a root is a quotient. No chord is too short to be found, because nothing is sampled. Steps far from the surface are
evaluated in float32, less its error bound; every sign and every root is computed in float64. An infinite `max_slope`
assumes no bound: every region from the box on is traversed, which is slower and verifies the bounded variant.

The solver detects a violated bound where it shows. Each beam begins with a region. If the slope of a region exceeds
`_SUSPECT` times the bound, the beam traverses every region from there on. If g fell by more than that share of the fall
that the bound allows, or turned negative in one step, the beam goes back and does the same.

The march skips regions shorter than a nanometre. Beams are clipped to the verified box, which includes the margin
`box_margin_m`: a decoder's values outside it are no part of the object (our choice: the paper cuts at 7 m).
"""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.render.beams import Beams, FirstHits
from shift3d.render.culling import Rays, rays_in_box
from shift3d.render.field.bounding_box import verified_box
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import RenderSettings

_REGION_M = 0.0005
"""Regions replace steps shorter than this: a region costs as much as five of these steps and is a millimetre long."""
_ROUNDING_M = 2e-5
"""Assumed error bound of a float32 value: 50 times the largest error in 37,500 places of fifteen shapes."""
_FALL = 1.1
"""Expected fall of g per metre of a beam, for choosing the next sample. A wrong guess costs one evaluation."""
_NUDGE_M = 1e-9
_SUSPECT = 0.8
_MOST_PIECES = 200_000


def first_hits(beams: Beams, field: ObjectField, theta: Tensor, size_m: Tensor, settings: RenderSettings) -> FirstHits:
    """Find the first crossing of g = 0 on every beam through the verified box.

    Args:
        field: metric distance in the object frame; its decoder must be piecewise linear.
        size_m: (3,) size of the baseline's box. settings: `box_margin_m` and `max_slope` are used.

    Unresolved beams: the sensor is inside the object, or the field is not finite before the first crossing. Not
    differentiable. Source: our choice: the paper samples every 0.1 m.
    """
    rays = rays_in_box(beams, theta, verified_box(field, size_m, settings.box_margin_m).box)
    traversal = Traversal(rays, field, settings.max_slope)
    traversal.run()
    hit = torch.nonzero(torch.isfinite(traversal.root_m)).squeeze(1)
    root = traversal.root_m[hit]
    residual = field(rays.at(root, hit)).double().abs()
    return FirstHits(rays.index[hit], root, residual, rays.index[traversal.undecided])


class Traversal:
    """A march over M rays: root_m (M,) float64, infinite if none; undecided (M,) bool."""

    def __init__(self, rays: Rays, field: ObjectField, max_slope: float) -> None:
        count = len(rays)
        self.rays, self.field = rays, field
        self.root_m = torch.full((count,), torch.inf, dtype=torch.float64)
        self.undecided = torch.zeros(count, dtype=torch.bool)
        self._bound = torch.full((count,), float(max_slope), dtype=torch.float64)
        self._k = rays.near_m.clone()
        self._rough = field.float32_copy()
        # The beam is known to be free up to k; the next evaluation is this far beyond k.
        self._ahead = torch.zeros(count, dtype=torch.float64)
        # Range and value before the last step that relied on the bound; NaN if there was none.
        self._k_before = torch.full((count,), torch.nan, dtype=torch.float64)
        self._g_before = self._k_before.clone()
        self._by_region = torch.ones(count, dtype=torch.bool)
        self._under_way = torch.ones(count, dtype=torch.bool)

    def run(self) -> None:
        """March until every ray has its first crossing or ends without one."""
        for _ in range(_MOST_PIECES):
            rows = torch.nonzero(self._under_way).squeeze(1)
            if len(rows) == 0:
                return
            by_region = self._by_region[rows]
            self._step(rows[~by_region])
            self._traverse_region(rows[by_region])
        self._give_up(torch.nonzero(self._under_way).squeeze(1))

    def _give_up(self, rows: Tensor) -> None:
        self.undecided[rows], self._under_way[rows] = True, False

    def _step(self, rows: Tensor) -> None:
        """Evaluate the field and advance as far as the bound on the slope allows.

        A value g proves the beam free within g / bound on either side. The next sample is therefore placed ahead of the
        free stretch, as far as its own value will probably reach back: one evaluation then covers half of the way to a
        surface instead of a third. If the value does not reach back, the next sample is at the end of the free stretch.
        """
        if len(rows) == 0:
            return
        ahead = self._ahead[rows]
        k = self._k[rows] + ahead
        g, error_bound = self._value(k, rows)
        reach = (g - error_bound) / self._bound[rows]
        short = (ahead > 0) & ~(reach >= ahead)
        self._ahead[rows[short]] = 0.0
        # Within the rounding error of the surface only float64 decides the sign.
        near = (reach < _REGION_M) & (g > -_ROUNDING_M) & (ahead == 0)
        self._by_region[rows[near]] = True
        rows, k, g = (part[~(short | near)] for part in (rows, k, g))
        rows, k, g = self._consistent_rows(rows, k, g)
        reach = (g - error_bound) / self._bound[rows]
        self._advance(rows, k, g, reach)
        expected = reach * (self._bound[rows] - _FALL) / (self._bound[rows] + _FALL)
        self._ahead[rows] = torch.minimum(expected, self.rays.far_m[rows] - self._k[rows]).clamp_min(0.0)
        slow = rows[reach < _REGION_M]
        self._by_region[slow], self._ahead[slow] = True, 0.0

    def _value(self, k: Tensor, rows: Tensor) -> tuple[Tensor, float]:
        """Compute g (M,) float64 and its error bound; in float32 if there is a finite float32 value."""
        places = self.rays.at(k, rows)
        if self._rough is None:
            return self.field(places).double(), 0.0
        g = self._rough(places).double()
        again = torch.nonzero(~torch.isfinite(g)).squeeze(1)
        g[again] = self.field(places[again]).double()
        return g, _ROUNDING_M

    def _traverse_region(self, rows: Tensor) -> None:
        """Find a root in the region; without one go to the region's end, or farther if the bound allows it."""
        if len(rows) == 0:
            return
        k = self._k[rows]
        region = self.field.region(self.rays.at(k, rows), self.rays.directions[rows])
        # A beam that arrived region by region can be inside only by rounding: then its root is here.
        after_jump = torch.isfinite(self._k_before[rows]) | (k == self.rays.near_m[rows]) | (k <= 0)
        value = torch.where(after_jump, region.value, region.value.clamp_min(0.0))
        kept, k_kept, g = self._consistent_rows(rows, k, value)
        chosen = torch.isin(rows, kept)
        self._bound[rows[region.slope.abs() > _SUSPECT * self._bound[rows]]] = torch.inf
        slope, length = region.slope[chosen], region.length[chosen] + _NUDGE_M
        root = torch.where(slope < 0, -g / slope, torch.inf)
        found = (root <= length) & (k_kept + root <= self.rays.far_m[kept])
        self.root_m[kept[found]] = k_kept[found] + root[found]
        self._under_way[kept[found]] = False
        rows, k, g, length = kept[~found], k_kept[~found], g[~found], length[~found]
        # The bound is that of the field after its tanh, whose value is below the value before the tanh.
        safe = torch.tanh(g / self.field.scale_m) * self.field.scale_m / self._bound[rows]
        jumps = safe > length
        self._by_region[rows] = ~(safe > 2 * _REGION_M)
        self._advance(rows[jumps], k[jumps], g[jumps], safe[jumps])
        self._k_before[rows[~jumps]] = torch.nan
        beyond = k[~jumps] + length[~jumps]
        self._k[rows[~jumps]] = beyond
        self._under_way[rows[~jumps][beyond > self.rays.far_m[rows[~jumps]]]] = False

    def _consistent_rows(self, rows: Tensor, k: Tensor, g: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Select the rows that are outside and respect the bound; send the others back or give them up."""
        lost = ~torch.isfinite(g)
        self._give_up(rows[lost])
        k_before, g_before = self._k_before[rows], self._g_before[rows]
        allowed = self._bound[rows] * (k - k_before)
        # k_before is NaN if no step relied on the bound; then every comparison is false.
        suspect = (g_before - g > _SUSPECT * allowed) & torch.isfinite(self._bound[rows]) & ~lost
        self._restart_by_region(rows[suspect], k_before[suspect])
        inside = (g < 0) & ~suspect & ~lost
        at_sensor = inside & (k <= 0)
        self._give_up(rows[at_sensor])
        # Inside at the start of the box: the crossing is in front of the box.
        self._restart_by_region(rows[inside & ~at_sensor], torch.zeros_like(k)[inside & ~at_sensor])
        kept = ~(lost | suspect | inside)
        return rows[kept], k[kept], g[kept]

    def _restart_by_region(self, rows: Tensor, k: Tensor) -> None:
        """Traverse every region from k on."""
        self._k[rows], self._k_before[rows] = k, torch.nan
        self._bound[rows], self._by_region[rows], self._ahead[rows] = torch.inf, True, 0.0

    def _advance(self, rows: Tensor, k: Tensor, g: Tensor, length: Tensor) -> None:
        """Step by a length that the bound proves free; the end of the ray is evaluated once."""
        far = self.rays.far_m[rows]
        self._under_way[rows[k >= far]] = False
        self._k[rows] = torch.minimum(k + length, far)
        self._k_before[rows], self._g_before[rows] = k, g
