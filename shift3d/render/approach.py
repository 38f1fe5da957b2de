"""From where hits are predicted to be, to the hits: one evaluation that the gradient needs anyway, for most of them.

Source: our choice: the paper searches every beam afresh.
"""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.follow import FLATTEST, Followed, follow
from shift3d.render.object_field import ObjectField
from shift3d.render.settings import RenderSettings
from shift3d.render.tangents import Tangents, tangents_at

STEEP = -0.05
"""A beam that meets the surface flatter than this is not taken at Newton's word: there it may lead anywhere."""
_SHARE = 0.5
"""Of `unchecked_m`: that step follows another, which has shown what the field does there; this one is the first."""


def find_near(
    rays: Rays,
    guess_m: Tensor,
    slope: Tensor,
    before: Tangents | None,
    field: ObjectField,
    settings: RenderSettings,
    reach_m: float,
) -> tuple[Followed, Tangents | None]:
    """Roots near guesses, as `follow` finds them; where an earlier rendering left tangents, from better guesses.

    Args:
        guess_m: (M,) ranges. slope: (M,) dg/dk there, negative. before: of an earlier rendering, of any of its beams.
        reach_m: how far a root may lie from its guess, and a better guess from this one.

    Returns:
        What `follow` returns; and tangents at those hits for which they were made on the way, which are to be taken
        one Newton step further (`implicit` does): None where none were.

    Not differentiable.
    """
    if before is None or settings.unchecked_m == 0:
        return follow(rays, guess_m, slope, field, settings, reach_m), None
    of = before.rows_of(rays.index)
    told, others = torch.nonzero(of >= 0).squeeze(1), torch.nonzero(of < 0).squeeze(1)
    predicted_m, change = predicted_hits(before.select(of[told]), rays.select(told), field)
    near = (predicted_m - guess_m[told]).abs() < reach_m
    start = torch.where(near, predicted_m, guess_m[told])
    found, tangents = _take_or_follow(rays.select(told), start, field, settings, reach_m)
    rest = follow(rays.select(others), guess_m[others], slope[others], field, settings, reach_m)
    # What g is now where the hit was: what was predicted, and what the prediction was off by.
    g_start = torch.where(near, change + found.g_start, found.g_start)
    parts = [
        torch.empty_like(guess_m).index_copy(0, told, one).index_copy(0, others, other)
        for one, other in (
            (torch.where((found.range_m - guess_m[told]).abs() < reach_m, found.range_m, torch.nan), rest.range_m),
            (found.residual_m, rest.residual_m),
            (found.slope, rest.slope),
            (g_start, rest.g_start),
        )
    ]
    kept = torch.isin(tangents.index, rays.index[torch.isfinite(parts[0])])
    return Followed(*parts), tangents.select(kept)


def predicted_hits(before: Tangents, rays: Rays, field: ObjectField) -> tuple[Tensor, Tensor]:
    """(M,) ranges at which rays will meet the surface, and (M,) by how much g has changed where they met it."""
    change = before.change(field, rays.at(before.range_m))
    slope = (before.gradient * rays.directions).sum(-1).clamp_max(FLATTEST)
    return before.range_m - (before.g + change) / slope, change


def _take_or_follow(
    rays: Rays, start_m: Tensor, field: ObjectField, settings: RenderSettings, reach_m: float
) -> tuple[Followed, Tangents]:
    """Take the roots that are next to where they are looked for, and follow the others."""
    start = torch.minimum(torch.maximum(start_m, rays.near_m), rays.far_m)
    tangents = tangents_at(field, rays, start)
    slope = (tangents.gradient * rays.directions).sum(-1)
    step = -tangents.g / slope.clamp_max(STEEP)
    near = (slope <= STEEP) & (step.abs() <= _SHARE * settings.unchecked_m)
    # What is a rounding away from 0 is a root however flat the beam; one that its ray does not reach is none.
    near |= (tangents.g.abs() <= settings.tolerance_m) & (slope < 0)
    near &= (start + step >= rays.near_m) & (start + step <= rays.far_m)
    range_m, residual, g = torch.where(near, start, torch.nan), tangents.g.abs(), tangents.g
    rest = torch.nonzero(~near).squeeze(1)
    if len(rest):
        onwards = start[rest] + step[rest].clamp(-reach_m, reach_m)
        found = follow(rays.select(rest), onwards, slope[rest], field, settings, reach_m)
        range_m[rest], residual[rest], slope[rest] = found.range_m, found.residual_m, found.slope
    return Followed(range_m, residual, slope, g), tangents.select(near)
