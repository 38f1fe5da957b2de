"""First crossings that are not stepped over where the field is no steeper than a bound: the reference.

Far from the surface nothing lies within g / `max_slope` of a place, because no field is steeper than that bound; near
it, where such steps would creep, the beam traverses the decoder's linear regions (see `sdf.linear_regions`) and the
root is a quotient. Nothing is sampled, so there is no chord too short to be found. Steps far from the surface are
evaluated in float32, less what that may be off by; every sign and every root is float64's. With an infinite `max_slope`
no bound is assumed at all and every region from the box on is traversed: slower, and the proof of the other.

A bound that does not hold is noticed where it shows: each beam begins with a region, and on one that is steeper than
`_SUSPECT` of the bound it traverses every region from there; one on which g fell by more than that share of what the
bound allows, or turned negative in one step, goes back and does the same.

Where a region is shorter than a nanometre, the next one is taken for it. Beams are cut to the verified box, grown by
`box_margin_m`: what a decoder makes of places outside it is no part of the object (our choice: the paper cuts at 7 m).
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
"""Steps shorter than this are left to the regions: one costs as much as five such steps, and is a millimetre long."""
_ROUNDING_M = 2e-5
"""What a float32 value is taken to be off by at most: 50 times the worst of 37,500 places of fifteen shapes."""
_FALL = 1.1
"""How fast g is expected to fall along a beam, for choosing where to look next. A wrong guess costs one evaluation."""
_NUDGE_M = 1e-9
_SUSPECT = 0.8
_MOST_PIECES = 200_000


def first_hits(beams: Beams, field: ObjectField, theta: Tensor, size_m: Tensor, settings: RenderSettings) -> FirstHits:
    """First crossing of g = 0 on every beam through the verified box.

    Args:
        field: metric distance in the object frame; its decoder must be piecewise linear.
        size_m: (3,) size of the baseline's box. settings: `box_margin_m` and `max_slope` are used.

    Unresolved: beams whose sensor is inside the object, or whose field is not finite before the first crossing.
    Not differentiable. Source: our choice: the paper samples every 0.1 m.
    """
    rays = rays_in_box(beams, theta, verified_box(field, size_m, settings.box_margin_m).box)
    traversal = Traversal(rays, field, settings.max_slope)
    traversal.run()
    hit = torch.nonzero(torch.isfinite(traversal.root_m)).squeeze(1)
    root = traversal.root_m[hit]
    residual = field(rays.at(root, hit)).double().abs()
    return FirstHits(rays.index[hit], root, residual, rays.index[traversal.undecided])


class Traversal:
    """A march over M rays: root_m (M,) float64, infinite where none; undecided (M,) bool."""

    def __init__(self, rays: Rays, field: ObjectField, max_slope: float) -> None:
        count = len(rays)
        self.rays, self.field = rays, field
        self.root_m = torch.full((count,), torch.inf, dtype=torch.float64)
        self.undecided = torch.zeros(count, dtype=torch.bool)
        self._bound = torch.full((count,), float(max_slope), dtype=torch.float64)
        self._k = rays.near_m.clone()
        self._rough = field.float32_copy()
        # How far beyond k, up to which the beam is known to be free, it is evaluated next.
        self._ahead = torch.zeros(count, dtype=torch.float64)
        # The place and value before the last step that relied on the bound; NaN where there was none.
        self._k_before = torch.full((count,), torch.nan, dtype=torch.float64)
        self._g_before = self._k_before.clone()
        self._by_region = torch.ones(count, dtype=torch.bool)
        self._under_way = torch.ones(count, dtype=torch.bool)

    def run(self) -> None:
        """Until every ray has its first crossing, or has ended without one."""
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

    def _end(self, rows: Tensor) -> None:
        self._under_way[rows] = False

    def _step(self, rows: Tensor) -> None:
        """Evaluate, and go on by what the bound on the slope allows.

        A value g tells that nothing lies within g / bound on either side. So the next place is chosen ahead of what is
        known to be free, as far as its own value will probably reach back: half of the way to a surface is covered by
        one evaluation then, instead of a third. Where it does not reach back, the beam is looked at where it was left.
        """
        if len(rows) == 0:
            return
        ahead = self._ahead[rows]
        k = self._k[rows] + ahead
        g, error_bound = self._value(k, rows)
        reach = (g - error_bound) / self._bound[rows]
        short = (ahead > 0) & ~(reach >= ahead)
        self._ahead[rows[short]] = 0.0
        # Within a rounding of the surface the sign is for float64 to tell.
        near = (reach < _REGION_M) & (g > -_ROUNDING_M) & (ahead == 0)
        self._by_region[rows[near]] = True
        rows, k, g = (part[~(short | near)] for part in (rows, k, g))
        rows, k, g = self._usable(rows, k, g)
        reach = (g - error_bound) / self._bound[rows]
        self._advance(rows, k, g, reach)
        expected = reach * (self._bound[rows] - _FALL) / (self._bound[rows] + _FALL)
        self._ahead[rows] = torch.minimum(expected, self.rays.far_m[rows] - self._k[rows]).clamp_min(0.0)
        slow = rows[reach < _REGION_M]
        self._by_region[slow], self._ahead[slow] = True, 0.0

    def _value(self, k: Tensor, rows: Tensor) -> tuple[Tensor, float]:
        """g (M,) float64, and by how much it may be off: in float32 where there is such a copy and it is finite."""
        places = self.rays.at(k, rows)
        if self._rough is None:
            return self.field(places).double(), 0.0
        g = self._rough(places).double()
        again = torch.nonzero(~torch.isfinite(g)).squeeze(1)
        g[again] = self.field(places[again]).double()
        return g, _ROUNDING_M

    def _traverse_region(self, rows: Tensor) -> None:
        """Look for a root on the region; if there is none, go to its end, or further where the bound allows."""
        if len(rows) == 0:
            return
        k = self._k[rows]
        region = self.field.region(self.rays.at(k, rows), self.rays.directions[rows])
        # A beam that came here along its regions cannot be inside but for a rounding: then its root is here.
        after_jump = torch.isfinite(self._k_before[rows]) | (k == self.rays.near_m[rows]) | (k <= 0)
        value = torch.where(after_jump, region.value, region.value.clamp_min(0.0))
        kept, k_kept, g = self._usable(rows, k, value)
        chosen = torch.isin(rows, kept)
        self._bound[rows[region.slope.abs() > _SUSPECT * self._bound[rows]]] = torch.inf
        slope, length = region.slope[chosen], region.length[chosen] + _NUDGE_M
        root = torch.where(slope < 0, -g / slope, torch.inf)
        found = (root <= length) & (k_kept + root <= self.rays.far_m[kept])
        self.root_m[kept[found]] = k_kept[found] + root[found]
        self._end(kept[found])
        rows, k, g, length = kept[~found], k_kept[~found], g[~found], length[~found]
        # tanh g / s is what the bound speaks of; it is below the value before the tanh.
        safe = torch.tanh(g / self.field.scale_m) * self.field.scale_m / self._bound[rows]
        jumps = safe > length
        self._by_region[rows] = ~(safe > 2 * _REGION_M)
        self._advance(rows[jumps], k[jumps], g[jumps], safe[jumps])
        self._k_before[rows[~jumps]] = torch.nan
        beyond = k[~jumps] + length[~jumps]
        self._k[rows[~jumps]] = beyond
        self._end(rows[~jumps][beyond > self.rays.far_m[rows[~jumps]]])

    def _usable(self, rows: Tensor, k: Tensor, g: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows that are outside, as the bound has it; the others are sent back, or left undecided."""
        lost = ~torch.isfinite(g)
        self._give_up(rows[lost])
        k_before, g_before = self._k_before[rows], self._g_before[rows]
        allowed = self._bound[rows] * (k - k_before)
        # NaN before: nothing to compare with.
        suspect = (g_before - g > _SUSPECT * allowed) & torch.isfinite(self._bound[rows]) & ~lost
        self._send_back(rows[suspect], k_before[suspect])
        inside = (g < 0) & ~suspect & ~lost
        at_sensor = inside & (k <= 0)
        self._give_up(rows[at_sensor])
        # Inside where the box begins: the crossing lies in front of it.
        self._send_back(rows[inside & ~at_sensor], torch.zeros_like(k)[inside & ~at_sensor])
        kept = ~(lost | suspect | inside)
        return rows[kept], k[kept], g[kept]

    def _send_back(self, rows: Tensor, k: Tensor) -> None:
        """Traverse every region from k on."""
        self._k[rows], self._k_before[rows] = k, torch.nan
        self._bound[rows], self._by_region[rows], self._ahead[rows] = torch.inf, True, 0.0

    def _advance(self, rows: Tensor, k: Tensor, g: Tensor, length: Tensor) -> None:
        """A step that relies on the bound; the ray's end is looked at, once."""
        far = self.rays.far_m[rows]
        self._end(rows[k >= far])
        self._k[rows] = torch.minimum(k + length, far)
        self._k_before[rows], self._g_before[rows] = k, g
