"""Errors of a rendering against the ground truth, beam by beam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.rendering import Rendering
from shift3d.task.differences import WRONG_SURFACE_M

THICK_CHORD_M = 0.02
"""The preset `standard` must not miss chords of this length or more (the project's claim)."""
_SAMPLE_M = 0.002
_CHORD_M = 0.05


@dataclass(frozen=True)
class TrueHits:
    """Ground truth of first hits.

    index: (M,) beams that hit, ascending. range_m: (M,) float64 ranges. chord_m: (M,) float64 length of each beam's
    segment inside the object behind its hit, at most 5 cm.
    """

    index: Tensor
    range_m: Tensor
    chord_m: Tensor

    @property
    def thick(self) -> Tensor:
        """Mask (M,) bool of the hits with a chord of at least `THICK_CHORD_M`."""
        return self.chord_m >= THICK_CHORD_M


def chord_lengths(field: ObjectField, rays: Rays, hit_m: Tensor) -> Tensor:
    """Measure the length of each ray inside the object behind its hit, by samples every 2 mm; at most 5 cm.

    Args:
        field: metric signed distance field in the object frame. Use float64: a hit is only as exact as its field.
        rays: (M) beams in the object frame. hit_m: (M,) ranges of their hits.

    Returns: (M,) float64 metres, up to the zero of the line through the last sample inside and the next sample. A chord
    shorter than 2 mm is zero unless the first sample is inside the chord.
    """
    length = torch.zeros(len(rays), dtype=torch.float64)
    g_before = torch.zeros_like(length)
    rows = torch.arange(len(rays))
    for number in range(1, round(_CHORD_M / _SAMPLE_M) + 1):
        g = field(rays.at(hit_m[rows] + number * _SAMPLE_M, rows)).double()
        inside = g < 0
        out = rows[~inside]
        # Share of the last step inside the object.
        share = torch.where(g_before[out] < 0, g_before[out] / (g_before[out] - g[~inside]), 0.0)
        length[out] += share * _SAMPLE_M
        rows = rows[inside]
        length[rows], g_before[rows] = number * _SAMPLE_M, g[inside]
        if len(rows) == 0:
            break
    return length


def compare(truth: TrueHits, rendering: Rendering) -> dict[str, Any]:
    """Count the wrong beams of a rendering by the ground truth of the same beams, as plain values.

    hits, thick_hits: true hits, and true hits with a chord of 2 cm or more. missed, missed_thick: true hits of either
    kind that the rendering misses. wrong: hits more than 1 cm off the true range. false: hits of beams without a true
    hit. depth_m: |depth error| of the remaining hits, metres.
    """
    hit, found_m = rendering.hit_mask[truth.index], rendering.range_m[truth.index]
    depth = (found_m - truth.range_m).abs()
    wrong = hit & (depth > WRONG_SURFACE_M)
    return {
        "hits": len(truth.index),
        "thick_hits": int(truth.thick.sum()),
        "missed": int((~hit).sum()),
        "missed_thick": int((~hit & truth.thick).sum()),
        "wrong": int(wrong.sum()),
        "false": int(rendering.hit_mask.sum()) - int(hit.sum()),
        "depth_m": depth[hit & ~wrong].tolist(),
    }
