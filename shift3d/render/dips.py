"""Dips towards the surface are followed to their bottom: a chord of millimetres lies between any two samples.

Source: our choice: the paper samples every 0.1 m and misses what lies between.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.seen import Seen

if TYPE_CHECKING:
    from shift3d.render.bracket import Brackets

_ROUNDS = 6
_NARROW_M = 2e-4
_STEEPER = 2.0
"""Between samples g may fall this much faster than it was seen to fall between them, and at least by _FLATTEST."""
_FLATTEST = 0.1


def look_into_dips(brackets: Brackets, seen: Seen, rays: Rays, field: ObjectField) -> Brackets:
    """The brackets with the first crossings that dips hold between their samples.

    Every dip is minimised by parabolas, as long as what lies between its samples could reach the surface. A sample
    inside that a march of several steps made and passed over, because what led there was not covered, is a crossing
    too. A ray whose field is not finite there is undecided.

    Args:
        seen: the samples of the march that the brackets come from; what is sampled here is added.
    """
    end = torch.where(brackets.found, brackets.inner, torch.inf)
    rows, k, g, left, right = seen.in_order(end)
    decided = ~brackets.undecided[rows]
    low = decided & (g > 0) & (g <= g[left]) & (g <= g[right]) & (right > left)
    passed = decided & (g < 0) & (g[left] >= 0) & (k < end[rows])
    # A shallow way down may touch the surface between two samples before it goes in.
    fall = _FLATTEST * (k - k[left])
    shelf = decided & (g > 0) & (g <= g[left]) & (g[left] - g < fall) & (2.0 * g < fall) & ~low
    if not bool((low | shelf | passed).any()):
        return brackets
    crossings = [_Crossings(rows[passed], k[left][passed], g[left][passed], k[passed], g[passed])]
    right = torch.where(shelf, torch.arange(len(rows)), right)
    looked = low | shelf
    dips = _Dips(rows[looked], *(part[at][looked] for at in (left, slice(None), right) for part in (k, g)))
    undecided = brackets.undecided.clone()
    for _ in range(_ROUNDS):
        on = torch.nonzero(dips.may_cross()).squeeze(1)
        if len(on) == 0:
            break
        there = dips.guess()[on]
        value = field(rays.at(there, dips.rows[on])).double()
        seen.add(dips.rows[on], there, value)
        undecided[dips.rows[on[~torch.isfinite(value)]]] = True
        inside = value < 0
        crossings.append(_Crossings(dips.rows[on], *dips.before(on, there), there, value).select(inside))
        dips.add(on, there, value)
    return replace(_with(brackets, _Crossings.of(crossings)), undecided=undecided)


def _with(brackets: Brackets, crossings: _Crossings) -> Brackets:
    """The brackets with each ray's first crossing."""
    nowhere = torch.full_like(brackets.inner, torch.inf)
    first = nowhere.scatter_reduce(0, crossings.rows, crossings.inner, "amin")
    found = crossings.select(crossings.inner == first[crossings.rows])
    parts = {name: getattr(brackets, name).clone() for name in ("found", "outer", "g_outer", "inner", "g_inner")}
    parts["found"][found.rows] = True
    for name in ("outer", "g_outer", "inner", "g_inner"):
        parts[name][found.rows] = getattr(found, name)
    return replace(brackets, **parts)


@dataclass(frozen=True)
class _Crossings:
    """C places where a ray goes in: ranges and distances before (outer) and behind, (C,) each."""

    rows: Tensor
    outer: Tensor
    g_outer: Tensor
    inner: Tensor
    g_inner: Tensor

    @staticmethod
    def of(parts: list[_Crossings]) -> _Crossings:
        return _Crossings(*(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(_Crossings)))

    def select(self, chosen: Tensor) -> _Crossings:
        return _Crossings(*(getattr(self, field.name)[chosen] for field in fields(self)))


class _Dips:
    """D dips of three samples each, the middle one the lowest: rows, ranges, distances (D,), changed in place."""

    def __init__(
        self, rows: Tensor, k_left: Tensor, g_left: Tensor, k: Tensor, g: Tensor, k_right: Tensor, g_right: Tensor
    ) -> None:
        self.rows = rows
        self.k_left, self.g_left, self.k, self.g = k_left, g_left, k, g
        self.k_right, self.g_right = k_right, g_right
        left, right = self._slopes()
        self.steepest = (_STEEPER * torch.maximum(left.abs(), right.abs())).clamp(_FLATTEST, 1.0)

    def _slopes(self) -> tuple[Tensor, Tensor]:
        left = (self.g - self.g_left) / (self.k - self.k_left).clamp_min(1e-12)
        right = (self.g_right - self.g) / (self.k_right - self.k).clamp_min(1e-12)
        return left, right

    def may_cross(self) -> Tensor:
        """(D,) bool: the surface may lie between the samples, and was not found there yet."""
        left = 0.5 * (self.g_left + self.g - self.steepest * (self.k - self.k_left))
        right = 0.5 * (self.g_right + self.g - self.steepest * (self.k_right - self.k))
        wide = self.k_right - self.k_left > _NARROW_M
        return (torch.minimum(left, right) < 0) & (self.g > 0) & wide

    def guess(self) -> Tensor:
        """(D,) the parabola's bottom; the middle of the longer side where that is no new place."""
        left, right = self._slopes()
        curvature = (right - left) / (self.k_right - self.k_left).clamp_min(1e-12)
        bottom = 0.5 * (self.k_left + self.k) - left / (2.0 * curvature)  # no number where g stays what it is
        width = self.k_right - self.k_left
        of_left = self.k - self.k_left > self.k_right - self.k
        middle = torch.where(of_left, 0.5 * (self.k_left + self.k), 0.5 * (self.k + self.k_right))
        new = (bottom > self.k_left + 0.02 * width) & (bottom < self.k_right - 0.02 * width)
        return torch.where(new & ((bottom - self.k).abs() > 0.02 * width), bottom, middle)

    def before(self, rows: Tensor, k: Tensor) -> tuple[Tensor, Tensor]:
        """The last sample before k (n,) of some dips: range and distance."""
        behind = k > self.k[rows]
        return (
            torch.where(behind, self.k[rows], self.k_left[rows]),
            torch.where(behind, self.g[rows], self.g_left[rows]),
        )

    def add(self, rows: Tensor, k: Tensor, g: Tensor) -> None:
        """A sample more (n,) of some dips: the lowest stays in the middle."""
        behind, lower = k > self.k[rows], g <= self.g[rows]
        new_left, new_right = lower & behind, lower & ~behind
        left, right = rows[new_left], rows[new_right]
        self.k_left[left], self.g_left[left] = self.k[left], self.g[left]
        self.k_right[right], self.g_right[right] = self.k[right], self.g[right]
        low = rows[lower]
        self.k[low], self.g[low] = k[lower], g[lower]
        to_right, to_left = ~lower & behind, ~lower & ~behind
        self.k_right[rows[to_right]], self.g_right[rows[to_right]] = k[to_right], g[to_right]
        self.k_left[rows[to_left]], self.g_left[rows[to_left]] = k[to_left], g[to_left]
