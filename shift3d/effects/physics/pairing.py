"""Pairing of rows that are returns of one beam, with their order."""

from __future__ import annotations

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
    """Returns paired by beam.

    beam: (N,) int64, see `beam_numbers`. number: (N,) int64, return number, 0 for the first return of a beam.
    """

    beam: Tensor
    number: Tensor

    @staticmethod
    def of(context: EffectContext) -> BeamReturns | None:
        """Pair the rows of a context. Returns None if the scene has no return numbers or no pixels."""
        scene, count = context.scene, len(context.beams)
        if scene.return_number is None or scene.range_image_index is None:
            return None
        number = torch.zeros(count, dtype=torch.long)  # a no-return beam gets one return at most
        number[: len(scene.points)] = torch.from_numpy(scene.return_number.astype(np.int64))
        return BeamReturns(torch.from_numpy(beam_numbers(scene, count)), number)

    @property
    def later(self) -> Tensor:
        """Mask (N,) of the rows that are not the first return of their beam."""
        return self.behind(torch.arange(len(self.beam)), torch.ones(len(self.beam), dtype=torch.bool))

    def behind(self, row: Tensor, some: Tensor) -> Tensor:
        """Return the mask (K,) of the rows with an earlier return of the same beam among the rows of the mask `some`.

        row: (K,) int64. some: (K,) bool.
        """
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
