"""Later returns of a beam that an inserted surface stops."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.render.field.object_field import VehicleFrame
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Scene

_NONE_YET = 256
"""More than any return number, which is a uint8."""


class SecondReturns(Effect):
    """One return a beam from an opaque object: later ones bring nothing back where an earlier one is on it too.

    An insertion moves every return whose beam meets the object; two returns of a beam behind it then lie in the same
    place twice. Of those the earliest stays. Where the object is between two returns, only the later one is on it
    and stays moved: the first passed the beam on in part, the object stops the rest.

    Left as they are: points, reflectance, and every row that is not on the object.

    Differentiable: points that stay keep their gradients; that a row is dropped carries none. It is dropped for good:
    the surface stops the light whether or not its own echo is lost afterwards.

    Source: two returns a beam, an opaque object; pairing by pixel is our choice.
    """

    name = "second_returns"
    kind: Kind = "returns"

    def applicability(self, scene: SceneFacts, vehicle: VehicleFrame, detector: DetectorFacts) -> str | None:
        """Where beams have more than one return that can be paired."""
        if scene.returns <= 1 or not scene.has_pixels:
            return None
        return f"{scene.returns} returns a beam: an opaque object in front of them sends back 1"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Rows are paired here, once. Nothing is drawn."""
        scene, count = context.scene, len(context.beams)
        if scene.return_number is None or scene.range_image_index is None:
            return unchanged
        number = torch.zeros(count, dtype=torch.long)  # beams that had no return have one at most
        number[: len(scene.points)] = torch.from_numpy(scene.return_number.astype(np.int64))
        beam = torch.from_numpy(beam_numbers(scene, count))

        def step(returns: Returns) -> Returns:
            later = returns.on_object & _behind(beam[returns.row], number[returns.row], returns.on_object, count)
            return returns.without(later) if bool(later.any()) else returns

        return step


def _behind(beam: Tensor, number: Tensor, on_object: Tensor, count: int) -> Tensor:
    """(K,) bool: whether an earlier return of the same beam is on the object; beam, number (K,) int64."""
    earliest = torch.full((count,), _NONE_YET, dtype=torch.long)
    earliest = earliest.scatter_reduce(0, beam[on_object], number[on_object], "amin")
    return number > earliest[beam]


def beam_numbers(scene: Scene, count: int) -> NDArray[np.int64]:
    """(count,) a number for each row, below `count`: the same for rows of the same beam.

    The same beam: the same pixel and the same origin, since several sensors may count their pixels alike. Rows
    without a pixel (negative indices, rows beyond the scene's points) are beams of their own.
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


EFFECT = SecondReturns()
