"""Corrector: moves predicted hits to roots by secant steps, or by Newton steps with the linearizations of the gradient.

Source: our choice: the paper searches every beam from scratch.
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
"""A beam with a flatter slope takes no last step without an evaluation: the step may lead anywhere."""


@dataclass(frozen=True)
class Corrected:
    """Results of correcting M predicted hits; (M,) float64 each.

    range_m: range of the root, NaN if none was reached. residual_m: |g| at the last evaluation. g_start: g at the
    prediction, metres. linearizations: at the roots, for Newton steps only.
    """

    range_m: Tensor
    residual_m: Tensor
    g_start: Tensor
    linearizations: Linearization | None


def correct(
    rays: Rays, start_m: Tensor, slope: Tensor | None, field: ObjectField, settings: RenderSettings, reach_m: float
) -> Corrected:
    """Step along M rays from predicted ranges to roots.

    Args:
        start_m: (M,) predictions. reach_m: largest distance of a root from its prediction.
        slope: (M,) dg/dk at the predictions, negative, for secant steps. None: Newton steps; their linearizations are
            returned, because the gradient needs them anyway.
        settings: `tolerance_m`, and `final_newton_m`: a last step of at most this length is not evaluated. A last
            secant step is taken; a last Newton step is left to `implicit`, so that the linearization is that at the
            root. On a beam flatter than `approach_slope` both are smaller: by the ratio of the slopes, and by its
            square.
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
        # On a grazing beam the same |g| is farther from the root, and a crease may be in between: both thresholds are
        # smaller. The last iteration uses the full tolerance, because rounding may allow no better.
        flat = (along.abs() / settings.approach_slope).clamp_max(1.0)
        short = (along <= NEWTON_SLOPE) & (step.abs() <= settings.final_newton_m * flat**2)
        strict = (along <= NEWTON_SLOPE) & (number < _STEPS - 1)
        at_root = (g.abs() <= settings.tolerance_m * torch.where(strict, flat, 1.0)) & (along < 0)
        next_k = k + step
        # A |g| within rounding of 0 makes a root however flat the beam is. A root outside its ray is none.
        found = (short | at_root) & (next_k >= here.near_m)
        found &= next_k <= here.far_m
        residual_m[rows] = g.abs()
        range_m[rows[found]] = torch.where(short, next_k, k)[found] if slope is not None else k[found]
        if slope is None:
            kept = at.select(found) if kept is None else kept.joined(at.select(found))
        next_k = torch.minimum(torch.maximum(next_k, here.near_m), here.far_m)
        # Where the slope is not negative the ray leaves the object or runs along it: no first hit.
        going = ~found & (along < 0) & ((next_k - start[rows]).abs() < reach_m)
        rows, k_before, g_before, k = rows[going], k[going], g[going], next_k[going]
        if len(rows) == 0:
            break
    return Corrected(range_m, residual_m, g_start, kept)


def predict(before: Linearization, rays: Rays, field: ObjectField) -> tuple[Tensor, Tensor]:
    """Predict hits from earlier ones. Returns (M,) ranges, and (M,) the change of g at the earlier ranges."""
    change = before.change(field, rays.at(before.range_m))
    slope = (before.gradient * rays.directions).sum(-1).clamp_max(_FLATTEST)
    return before.range_m - (before.g + change) / slope, change
