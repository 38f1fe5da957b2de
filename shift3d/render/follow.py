"""Secant steps from a place near a root: what is known roughly needs no bracket."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.settings import RenderSettings

_STEPS = 4
FLATTEST = -0.02


@dataclass(frozen=True)
class Followed:
    """What came of following M rays; (M,) float64 each.

    range_m: of the root, NaN where none was reached. residual_m: |g| where it was evaluated last. slope: dg/dk
    there. g_start: g at the start, metres.
    """

    range_m: Tensor
    residual_m: Tensor
    slope: Tensor
    g_start: Tensor


def follow(
    rays: Rays, start_m: Tensor, slope: Tensor, field: ObjectField, settings: RenderSettings, reach_m: float
) -> Followed:
    """Secant steps along rays from guessed ranges.

    Args:
        start_m: (M,) guesses. slope: (M,) dg/dk there, negative. reach_m: how far a root may lie from its guess.
        settings: `tolerance_m`, and `unchecked_m`: a last step shorter than this is not evaluated again, because
            somebody who evaluates the gradient at the root takes one more Newton step (see `implicit`).

    Not differentiable. Source: our choice: the paper searches every beam afresh.
    """
    start = torch.minimum(torch.maximum(start_m, rays.near_m), rays.far_m)
    k, slope = start.clone(), slope.clamp_max(FLATTEST).clone()
    g = field(rays.at(k)).double()
    g_start = g.clone()
    settled = g.abs() <= settings.tolerance_m
    active = torch.nonzero(~settled).squeeze(1)
    for _ in range(_STEPS):
        k_new = k[active] - g[active] / slope[active]
        short = (k_new - k[active]).abs() <= settings.unchecked_m
        k[active[short]], settled[active[short]] = k_new[short], True
        active, k_new = active[~short], k_new[~short]
        if len(active) == 0:
            break
        g_new = field(rays.at(k_new, active)).double()
        step = k_new - k[active]
        secant = torch.where(step.abs() > 1e-9, (g_new - g[active]) / step, slope[active])
        k[active], g[active], slope[active] = k_new, g_new, secant.clamp_max(FLATTEST)
        # A slope that is not negative is a way out of the object, not into it.
        lost = (secant >= 0) | ((k_new - start[active]).abs() >= reach_m) | torch.isnan(g_new)
        done = (g_new.abs() <= settings.tolerance_m) & ~lost
        settled[active[done]] = True
        active = active[~done & ~lost]
    good = settled & ((k - start).abs() < reach_m) & (k >= rays.near_m) & (k <= rays.far_m)
    return Followed(torch.where(good, k, torch.nan), g.abs(), slope, g_start)
