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

_STEPS = 5
_FLATTEST = -0.02
NEWTON_SLOPE = -0.05
"""A beam that meets the surface flatter than this takes no last step without an evaluation: it may lead anywhere."""


@dataclass(frozen=True)
class Corrected:
    """What became of M predicted hits; (M,) float64 each.

    range_m: of the root, NaN where none was reached. residual_m: |g| where it was evaluated last. g_start: g at the
    prediction, metres. linearizations: at the roots, where they were made on the way.
    """

    range_m: Tensor
    residual_m: Tensor
    g_start: Tensor
    linearizations: Linearization | None


def correct(
    rays: Rays, start_m: Tensor, slope: Tensor | None, field: ObjectField, settings: RenderSettings, reach_m: float
) -> Corrected:
    """Steps along M rays from predicted ranges to roots.

    Args:
        start_m: (M,) predictions. reach_m: how far a root may lie from them.
        slope: (M,) dg/dk there, negative, for secant steps; None: Newton steps by linearizations, which are kept.
        settings: `tolerance_m`, and `final_newton_m`: a last step of at most this length is not evaluated. A secant
            step is taken; a Newton step is left to `implicit`, so that the linearization is that at the root. On a beam
            flatter than `approach_slope` both are smaller, by its slope and the square of its slope over that one.

    Not differentiable.
    """
    k = torch.minimum(torch.maximum(start_m, rays.near_m), rays.far_m)
    start, range_m = k, torch.full_like(k, torch.nan)
    residual_m, g_start, kept = range_m.clone(), range_m, None
    rows, k_before, g_before = torch.arange(len(rays)), k, k
    for number in range(_STEPS):
        here = rays.select(rows)
        if slope is None:
            at = linearize(field, here, k)
            g, along = at.g, (at.gradient * here.directions).sum(-1)
        else:
            g, along, step = field(here.at(k)).double(), slope[rows], k - k_before
            if number:
                along = torch.where(step.abs() > 1e-9, (g - g_before) / step, along)
        g_start = g_start if number else g
        step = -g / along.clamp_max(_FLATTEST if slope is not None else NEWTON_SLOPE)
        # Where a beam grazes, the same |g| is further from the root, and a crease may lie between: both thresholds are
        # smaller there. The last iteration takes what rounding allows.
        flat = (along.abs() / settings.approach_slope).clamp_max(1.0)
        short = (along <= NEWTON_SLOPE) & (step.abs() <= settings.final_newton_m * flat**2)
        strict = (along <= NEWTON_SLOPE) & (number < _STEPS - 1)
        at_root = (g.abs() <= settings.tolerance_m * torch.where(strict, flat, 1.0)) & (along < 0)
        next_k = k + step
        # What is a rounding away from 0 is a root however flat the beam; one that its ray does not reach is none.
        found = (short | at_root) & (next_k >= here.near_m)
        found &= next_k <= here.far_m
        residual_m[rows] = g.abs()
        range_m[rows[found]] = torch.where(short, next_k, k)[found] if slope is not None else k[found]
        if slope is None:
            kept = at.select(found) if kept is None else kept.joined(at.select(found))
        next_k = torch.minimum(torch.maximum(next_k, here.near_m), here.far_m)
        # A slope that is not negative is a way out of the object, not into it.
        going = ~found & (along < 0) & ((next_k - start[rows]).abs() < reach_m)
        rows, k_before, g_before, k = rows[going], k[going], g[going], next_k[going]
        if len(rows) == 0:
            break
    return Corrected(range_m, residual_m, g_start, kept)


def predict(before: Linearization, rays: Rays, field: ObjectField) -> tuple[Tensor, Tensor]:
    """(M,) ranges at which rays will meet the surface, and (M,) by how much g has changed where they met it."""
    change = before.change(field, rays.at(before.range_m))
    slope = (before.gradient * rays.directions).sum(-1).clamp_max(_FLATTEST)
    return before.range_m - (before.g + change) / slope, change
