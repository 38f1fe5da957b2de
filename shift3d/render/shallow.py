"""Brackets that the surface crosses at a flat angle are looked into: there may be more than one crossing in them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField

if TYPE_CHECKING:
    from shift3d.render.bracket import Brackets

_SHALLOW = 0.3
_LOOK_EVERY_M = 0.003
_MOST_LOOKS = 24


def look_into_shallow(brackets: Brackets, rays: Rays, field: ObjectField) -> Brackets:
    """The brackets with those that g crosses at a flat angle cut down to their first crossing.

    A beam that skims a curved panel can dip into it by less than a millimetre, come out and go in again, all within
    one step. Brackets across which g falls by less than `_SHALLOW` a metre are therefore sampled every 3 mm. Where g
    is not finite before that crossing the ray is undecided.
    """
    width = brackets.inner - brackets.outer
    fall = (brackets.g_outer - brackets.g_inner) / width.clamp_min(1e-12)
    rows = torch.nonzero(brackets.found & ~brackets.undecided & (fall < _SHALLOW) & (width > _LOOK_EVERY_M)).squeeze(1)
    if len(rows) == 0:
        return brackets
    count = int((width[rows].max() / _LOOK_EVERY_M).ceil().clamp(max=_MOST_LOOKS))
    share = torch.arange(count + 1, dtype=torch.float64) / count
    k = brackets.outer[rows, None] + width[rows, None] * share
    inner = field(rays.at(k[:, 1:-1].reshape(-1), rows.repeat_interleave(count - 1))).double()
    inner = inner.reshape(len(rows), count - 1)
    g = torch.cat((brackets.g_outer[rows, None], inner, brackets.g_inner[rows, None]), dim=1)
    first = (g < 0).byte().argmax(1, keepdim=True)
    parts = {"outer": (k, first - 1), "g_outer": (g, first - 1), "inner": (k, first), "g_inner": (g, first)}
    cut = {}
    for name, (values, at) in parts.items():
        cut[name] = getattr(brackets, name).clone()
        cut[name][rows] = values.gather(1, at)[:, 0]
    lost = (~torch.isfinite(g) & (torch.arange(count + 1) <= first)).any(1)
    cut["undecided"] = brackets.undecided.clone()
    cut["undecided"][rows[lost]] = True
    return replace(brackets, **cut)
