"""Pairing of rows that are returns of one beam, with their order."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.effects.base import EffectContext
from shift3d.scenes.scene import Scene

_NO_NUMBER = 256
"""Larger than any return number, which is a uint8."""


@dataclass(frozen=True)
class BeamReturns:
    """Returns paired by beam: (N,) int64 `beam_numbers`, and return numbers, 0 for the first return of a beam."""

    beam: Tensor
    number: Tensor

    @staticmethod
    def of(context: EffectContext) -> BeamReturns:
        """Pair the rows of a context. Without return numbers or pixels each row is a beam of its own."""
        scene, count = context.scene, len(context.beams)
        beam, number = torch.arange(count), torch.zeros(count, dtype=torch.long)
        if scene.return_number is not None and scene.range_image_index is not None:
            beam = torch.from_numpy(beam_numbers(scene, count))
            number[: len(scene.points)] = torch.from_numpy(scene.return_number.astype(np.int64))
        return BeamReturns(beam, number)

    @functools.cached_property
    def later(self) -> Tensor:
        """Mask (N,) of the rows that are not the first return of their beam."""
        return self.behind(torch.arange(len(self.beam)), torch.ones(len(self.beam), dtype=torch.bool))

    def behind(self, row: Tensor, some: Tensor) -> Tensor:
        """Return the mask (K,) of rows (K,) int64 with an earlier return of their beam among those of a mask (K,)."""
        beam, number = self.beam[row], self.number[row]
        earliest = torch.full_like(self.beam, _NO_NUMBER).scatter_reduce(0, beam[some], number[some], "amin")
        return number > earliest[beam]


def beam_numbers(scene: Scene, count: int) -> NDArray[np.int64]:
    """Number the beams: (count,), each below `count`; rows of one beam have the same number.

    Rows of one beam share pixel and origin; the origin counts because several sensors may use equal pixels. A row
    without a pixel (negative indices, rows beyond the scene's points) is a beam of its own.
    """
    assert scene.range_image_index is not None
    pixel = scene.range_image_index.astype(np.int64)
    known = (pixel >= 0).all(axis=1)
    keys = [pixel[known, 0], pixel[known, 1]]
    if not bool((scene.origins == scene.origins[:1]).all()):
        keys += list(scene.origins[known].T)
    order = np.lexsort(keys)
    starts = np.zeros(len(order), dtype=bool)
    for key in keys:
        ordered = key[order]
        starts[1:] |= ordered[1:] != ordered[:-1]
    rows = np.flatnonzero(known)[order]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    beams = np.arange(count)
    beams[rows] = rows[first]
    return beams
