"""From where hits are predicted to be, to the hits: secant steps, or Newton steps that the gradient needs anyway.

Source: our choice: the paper searches every beam afresh.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.field.linearization import Linearization, linearize
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import RenderSettings

_STEPS = 4
_FLATTEST = -0.02
NEWTON_SLOPE = -0.05
"""A beam that meets the surface flatter than this takes no last step without an evaluation: it may lead anywhere."""


@dataclass(frozen=True)
class Corrected:
    """What became of M predicted hits; (M,) float64 each.

    range_m: of the root, NaN where none was reached. residual_m: |g| where it was evaluated last. slope: dg/dk there.
    g_start: g at the prediction, metres.
    """

    range_m: Tensor
    residual_m: Tensor
    slope: Tensor
    g_start: Tensor


def secant(
    rays: Rays, start_m: Tensor, slope: Tensor, field: ObjectField, settings: RenderSettings, reach_m: float
) -> Corrected:
    """Secant steps along M rays from predicted ranges.

    Args:
        start_m: (M,) predictions. slope: (M,) dg/dk there, negative. reach_m: how far a root may lie from them.
        settings: `tolerance_m`, and `final_newton_m`: a last step shorter than this is not evaluated again, because
            the gradient at the root is, and takes one more Newton step (see `implicit`).

    Not differentiable.
    """
    start = torch.minimum(torch.maximum(start_m, rays.near_m), rays.far_m)
    k, slope = start.clone(), slope.clamp_max(_FLATTEST).clone()
    g = field(rays.at(k)).double()
    g_start = g.clone()
    converged = g.abs() <= settings.tolerance_m
    active = torch.nonzero(~converged).squeeze(1)
    for _ in range(_STEPS):
        k_new = k[active] - g[active] / slope[active]
        short = (k_new - k[active]).abs() <= settings.final_newton_m
        k[active[short]], converged[active[short]] = k_new[short], True
        active, k_new = active[~short], k_new[~short]
        if len(active) == 0:
            break
        g_new = field(rays.at(k_new, active)).double()
        step = k_new - k[active]
        seen = torch.where(step.abs() > 1e-9, (g_new - g[active]) / step, slope[active])
        k[active], g[active], slope[active] = k_new, g_new, seen.clamp_max(_FLATTEST)
        # A slope that is not negative is a way out of the object, not into it.
        lost = (seen >= 0) | ((k_new - start[active]).abs() >= reach_m) | torch.isnan(g_new)
        done = (g_new.abs() <= settings.tolerance_m) & ~lost
        converged[active[done]] = True
        active = active[~done & ~lost]
    good = converged & ((k - start).abs() < reach_m) & (k >= rays.near_m) & (k <= rays.far_m)
    return Corrected(torch.where(good, k, torch.nan), g.abs(), slope, g_start)


def newton(
    rays: Rays, start_m: Tensor, field: ObjectField, settings: RenderSettings, reach_m: float
) -> tuple[Corrected, Linearization]:
    """Newton steps along M rays from predicted ranges, by linearizations that the gradient uses again.

    A root counts as found where the next step is at most `final_newton_m`; `implicit` takes that step. Returns the
    linearizations at the roots that were found, one each. Not differentiable.
    """
    k = torch.minimum(torch.maximum(start_m, rays.near_m), rays.far_m)
    start, range_m = k.clone(), torch.full_like(k, torch.nan)
    residual, slope, g_start = range_m.clone(), range_m.clone(), range_m.clone()
    kept: list[Linearization] = []
    rows = torch.arange(len(rays))
    for step_number in range(_STEPS):
        here = rays.select(rows)
        at = linearize(field, here, k[rows])
        along = (at.gradient * here.directions).sum(-1)
        if step_number == 0:
            g_start = at.g.clone()
        residual[rows], slope[rows] = at.g.abs(), along
        step = -at.g / along.clamp_max(NEWTON_SLOPE)
        # Where a beam grazes, the next step says little: there it has to be shorter.
        allowed = settings.final_newton_m * (along.abs() / settings.approach_slope).clamp_max(1.0)
        found = (along <= NEWTON_SLOPE) & (step.abs() <= allowed)
        # What is a rounding away from 0 is a root however flat the beam; one that its ray does not reach is none.
        found |= (at.g.abs() <= settings.tolerance_m) & (along < 0)
        next_k = k[rows] + step
        found &= (next_k >= here.near_m) & (next_k <= here.far_m)
        range_m[rows[found]] = k[rows[found]]
        kept.append(at.select(found))
        k[rows] = torch.minimum(torch.maximum(next_k, here.near_m), here.far_m)
        going = ~found & (along < 0) & ((k[rows] - start[rows]).abs() < reach_m)
        rows = rows[going]
        if len(rows) == 0:
            break
    joined = kept[0]
    for more in kept[1:]:
        joined = joined.joined(more)
    return Corrected(range_m, residual, slope, g_start), joined


def predict(before: Linearization, rays: Rays, field: ObjectField) -> tuple[Tensor, Tensor]:
    """(M,) ranges at which rays will meet the surface, and (M,) by how much g has changed where they met it."""
    change = before.change(field, rays.at(before.range_m))
    slope = (before.gradient * rays.directions).sum(-1).clamp_max(_FLATTEST)
    return before.range_m - (before.g + change) / slope, change
