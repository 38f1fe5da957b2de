"""Bracketing of the first crossing: sphere tracing and marching in one.

Plain sphere tracing crawls along grazing beams, plain marching wastes evaluations in free space. Here a step
is a share of the field's own distance, never below `step_m` and never above `max_step_m`, so that free space
costs little, a surface is crossed rather than crept up to, and every beam ends after at most
(stretch / step_m) steps; along a panel it is twice as long, where both its ends cover it. Where samples dip towards
the surface without a change of sign, `look_into_dips` follows them to the bottom when the march has ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.dips import look_into_dips
from shift3d.render.empty_space import Leaps
from shift3d.render.object_field import ObjectField
from shift3d.render.seen import Seen
from shift3d.render.settings import RenderSettings
from shift3d.render.shallow import look_into_shallow

_BACK_STEP_M = 0.1
_BOLDNESS = 0.95
_STEEPEST = 10.0
# A decoder takes as long for one point as for thirty: what is left of a march at its end is looked at ahead of time.
_FEW = 32
_AHEAD = 64
_AHEAD_SHARE = 0.7


@dataclass(frozen=True)
class Brackets:
    """First brackets of M rays.

    Attributes:
        found: (M,) bool, whether g changes from outside to inside on the stretch.
        outer, inner: (M,) float64 ranges with g >= 0 and g < 0 (meaningless where not found).
        g_outer, g_inner: (M,) values there, metres.
        undecided: (M,) bool, the sensor itself is inside the object, or the field was not finite on the way.
    """

    found: Tensor
    outer: Tensor
    inner: Tensor
    g_outer: Tensor
    g_inner: Tensor
    undecided: Tensor

    def select(self, rows: Tensor) -> Brackets:
        """Those of some rays."""
        return Brackets(*(part[rows] for part in vars(self).values()))


def first_brackets(
    rays: Rays, field: ObjectField, settings: RenderSettings, leaps: Leaps | None = None, seen: Seen | None = None
) -> Brackets:
    """March every ray from near_m to far_m until g < 0; where `leaps` is given, over empty cells in one go.

    seen: takes down all samples, by row of the rays.

    Source: our choice: the paper samples every 0.1 m. The test g < 0, and the sample at the return itself,
    are the paper's; g exactly 0 counts as outside.
    """
    march = _March(rays, field, settings, leaps, Seen() if seen is None else seen)
    march.start()
    while len(march.rows):
        if len(march.rows) > _FEW:
            march.step()
        else:
            march.steps_ahead()
    brackets = Brackets(march.found, march.outer, march.inner, march.g_outer, march.g_inner, march.undecided)
    return looked_into(brackets, march.seen, rays, field, settings)


def looked_into(brackets: Brackets, seen: Seen, rays: Rays, field: ObjectField, settings: RenderSettings) -> Brackets:
    """The brackets with what lies between the samples that they come from, where `look_between` asks for it."""
    if settings.look_between:
        brackets = look_into_shallow(look_into_dips(brackets, seen, rays, field), rays, field)
    # Here alone, for all that looked: an undecided ray is no hit, whatever it met.
    return replace(brackets, found=brackets.found & ~brackets.undecided)


class _March:
    """The state of a march; `rows` are the rays still under way, the other arrays belong to all rays."""

    def __init__(
        self, rays: Rays, field: ObjectField, settings: RenderSettings, leaps: Leaps | None, seen: Seen
    ) -> None:
        count = len(rays)
        self.rays, self.field, self.settings, self.leaps = rays, field, settings, leaps
        self.outer, self.inner = rays.near_m.clone(), rays.near_m.clone()
        self.g_outer = torch.full((count,), torch.inf, dtype=torch.float64)
        self.g_inner = torch.full((count,), torch.nan, dtype=torch.float64)
        self.found = torch.zeros(count, dtype=torch.bool)
        self.undecided = torch.zeros(count, dtype=torch.bool)
        # One sample further back than `outer`, for slopes and dips.
        self.before = self.outer.clone()
        self.g_before = self.g_outer.clone()
        # What a step of several showed of the field's steepness before it was taken back.
        self.steepest = torch.ones(count, dtype=torch.float64)
        self.rows = torch.arange(count)
        self.seen = seen

    def _g(self, k: Tensor, rows: Tensor, expected: Tensor | None = None) -> Tensor:
        g = self.field.estimate(self.rays.at(k, rows), expected).double()
        lost = ~torch.isfinite(g)
        self.undecided[rows[lost]] = True
        self.seen.add(rows, k, g)
        return torch.where(lost, torch.inf, g)

    def start(self) -> None:
        """Evaluate the entry points; where one is already inside, step back towards the sensor."""
        if self.leaps is not None:
            self.outer = self.leaps.first()
            self.rows = torch.nonzero(self.outer <= self.rays.far_m).squeeze(1)
        self.g_outer[self.rows] = self._g(self.outer[self.rows], self.rows)
        rows = torch.nonzero(self.g_outer < 0).squeeze(1)
        while len(rows):
            k = self.outer[rows]
            self.inner[rows], self.g_inner[rows] = k, self.g_outer[rows]
            at_sensor = k <= 0
            self.undecided[rows[at_sensor]] = True
            rows, k = rows[~at_sensor], (k[~at_sensor] - _BACK_STEP_M).clamp_min(0.0)
            self.outer[rows], self.g_outer[rows] = k, self._g(k, rows)
            out = self.g_outer[rows] >= 0
            self.found[rows[out]] = True
            rows = rows[~out]
        self.rows = self.rows[((self.g_outer >= 0) & ~self.found & ~self.undecided)[self.rows]]

    def step(self) -> None:
        """Move every ray under way by one step and drop those that are decided."""
        rows = self.rows
        k, g, far = self.outer[rows], self.g_outer[rows], self.rays.far_m[rows]
        sure, bold = self._lengths(rows, g)
        k_sure, k_new = torch.minimum(k + sure, far), torch.minimum(k + bold, far)
        if self.leaps is not None:
            leapt = self.leaps.leap(k_sure, rows)
            clear = leapt > far
            rows, k, g, far, k_sure, k_new, leapt = (x[~clear] for x in (rows, k, g, far, k_sure, k_new, leapt))
            empty_ahead = leapt > k_sure
            k_sure, k_new = (torch.where(empty_ahead, leapt, x) for x in (k_sure, k_new))
        # What a map leaves to be asked is next to the surface.
        expected = g + self._slope(rows, g) * (k_new - k) if self.leaps is None else torch.zeros_like(g)
        g_new = self._g(k_new, rows, expected)
        k_new, g_new = self._back_to_sure(rows, k_new, g_new, k_sure)
        inside = g_new < 0
        self._enter(rows[inside], k_new[inside], g_new[inside])
        ended = (k_new >= far) & ~inside
        self.before[rows], self.g_before[rows] = k, g
        going = ~inside & ~ended
        self.outer[rows[going]], self.g_outer[rows[going]] = k_new[going], g_new[going]
        self.rows = rows[going]

    def steps_ahead(self) -> None:
        """Several steps of the few rays that are left, evaluated at once as if g stayed what it is.

        They count as far as the spheres around them cover the beam, and are shorter than single steps.
        """
        rows, k, g = self.rows, self.outer[self.rows], self.g_outer[self.rows]
        far = self.rays.far_m[rows]
        if self.leaps is not None:
            leapt = self.leaps.leap(k, rows)
            clear = leapt > far
            rows, k, g, far, leapt = (x[~clear] for x in (rows, k, g, far, leapt))
            leaping = leapt > k
            k = torch.where(leaping, leapt - self.settings.step_m, k)
        else:
            leaping = torch.zeros(len(rows), dtype=torch.bool)
        if len(rows) == 0:
            self.rows = rows
            return
        length = torch.where(leaping, self.settings.step_m, _AHEAD_SHARE * self._lengths(rows, g)[0])
        ahead = max(2, _AHEAD // len(rows))
        places = torch.minimum(k[:, None] + length[:, None] * torch.arange(ahead + 1), far[:, None])
        x = self.rays.at(places[:, 1:].reshape(-1), rows.repeat_interleave(ahead))
        values = torch.cat((g[:, None], self.field(x).double().reshape(len(rows), ahead)), dim=1)
        self.seen.add(rows.repeat_interleave(ahead), places[:, 1:].reshape(-1), values[:, 1:].reshape(-1))
        lost = ~torch.isfinite(values)
        values = values.masked_fill(lost, torch.inf)
        gap, steepness = self._gaps(rows, places, values, leaping)
        slack = self.settings.step_m
        stops = (values[:, 1:] < 0) | (gap > slack)
        stop = torch.where(stops.any(1), stops.byte().argmax(1), ahead)  # the steps that count
        last, after = stop[:, None], (stop + 1).clamp_max(ahead)[:, None]
        self.undecided[rows] |= lost.logical_and_(torch.arange(ahead + 1) <= after).any(1)
        # A step that is not covered is taken again, shorter, wherever it led.
        uncovered = gap.gather(1, stop.clamp_max(ahead - 1)[:, None])[:, 0] > slack
        # So that it ends: where the first one is not, the next is as much shorter as the field is steeper there.
        self.steepest[rows] = torch.where(uncovered & (stop == 0), steepness[:, 0], 1.0)
        inside = stops.any(1) & (values.gather(1, after)[:, 0] < 0) & ~uncovered
        self.before[rows], self.g_before[rows] = k, g
        k_last, g_last = places.gather(1, last)[:, 0], values.gather(1, last)[:, 0]
        self.outer[rows], self.g_outer[rows] = k_last, g_last
        k_after, g_after = places.gather(1, after)[:, 0], values.gather(1, after)[:, 0]
        self._enter(rows[inside], k_after[inside], g_after[inside])
        ended = ~inside & (k_last >= far)
        self.rows = rows[~inside & ~ended]

    def _gaps(self, rows: Tensor, places: Tensor, values: Tensor, leaping: Tensor) -> tuple[Tensor, Tensor]:
        """What of each step between samples the spheres around its ends leave uncovered, and the steepness taken."""
        covered = self.settings.step_safety * values.clamp_min(0.0)
        covered[leaping, 0] = torch.inf  # by the map
        width = places.diff(dim=1)
        # As steep as over any step up to here: across a thin part two samples alone look flat.
        fall = (-values.diff(dim=1).nan_to_num() / width.clamp_min(1e-12)).cummax(dim=1).values
        steepness = torch.maximum(fall, self._steepness(rows)[:, None]).clamp_max(_STEEPEST)
        return width - (covered[:, 1:] + covered[:, :-1]) / steepness, steepness

    def _lengths(self, rows: Tensor, g: Tensor) -> tuple[Tensor, Tensor]:
        """Two lengths of the next step: one that g alone makes safe, and one to try.

        A beam along a panel keeps its distance, and the far end of a step vouches for as much of it as the near end
        does: if g stays as its slope says, twice the length is covered. Source: Keinert et al. 2014, over-relaxation.
        """
        s = self.settings
        steepness, longest = self._steepness(rows), max(s.step_m, s.max_step_m)
        covered = s.step_safety * g / steepness
        sure = (covered + s.step_m).clamp_max(longest)
        slope = self._slope(rows, g).nan_to_num(nan=-1.0).clamp(-1.0, 0.5)
        bold = _BOLDNESS * (2.0 * covered + s.step_m) / (1.0 - slope)
        return sure, torch.maximum(sure, bold.clamp_max(longest))

    def _slope(self, rows: Tensor, g: Tensor) -> Tensor:
        """How g changed over the last step, a metre; NaN where there was none."""
        length = self.outer[rows] - self.before[rows]
        slope = (g - self.g_before[rows]) / length.clamp_min(1e-12)
        return torch.where((length > 0) & torch.isfinite(slope), slope, torch.nan)

    def _back_to_sure(self, rows: Tensor, k_new: Tensor, g_new: Tensor, k_sure: Tensor) -> tuple[Tensor, Tensor]:
        """Take the safe step after all where a longer one is not covered from both its ends."""
        s = self.settings
        covered = s.step_safety * g_new / self._steepness(rows)
        again = torch.nonzero((k_new > k_sure) & ~((g_new >= 0) & (k_new - covered <= k_sure))).squeeze(1)
        if len(again):
            k_new, g_new = k_new.clone(), g_new.clone()
            k_new[again] = k_sure[again]
            g_new[again] = self._g(k_sure[again], rows[again], torch.zeros_like(g_new[again]))
        return k_new, g_new

    def _steepness(self, rows: Tensor) -> Tensor:
        """How much faster than a distance g fell over the last step (1 where it did not)."""
        fell = self.g_before[rows] - self.g_outer[rows]
        length = (self.outer[rows] - self.before[rows]).clamp_min(1e-12)
        fall = torch.where(torch.isfinite(fell), fell / length, 1.0).clamp(1.0, _STEEPEST)
        return torch.maximum(fall, self.steepest[rows])

    def _enter(self, rows: Tensor, k: Tensor, g: Tensor) -> None:
        self.found[rows], self.inner[rows], self.g_inner[rows] = True, k, g
