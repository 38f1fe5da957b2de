"""What a solver hands back."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class FirstHits:
    """First crossings of g = 0, found by either renderer.

    Attributes:
        index: (M,) beams that hit, ascending.
        range_m: (M,) float64 distance of the crossing from the sensor.
        residual_m: (M,) float64 |metric g| there.
        unresolved: (U,) beams that could not be decided, ascending: sensor inside the object, or out of
            iterations. They stay where they are.
    """

    index: Tensor
    range_m: Tensor
    residual_m: Tensor
    unresolved: Tensor

    @staticmethod
    def none() -> FirstHits:
        """No hit and nothing unresolved."""
        index, value = torch.empty(0, dtype=torch.long), torch.empty(0, dtype=torch.float64)
        return FirstHits(index, value, value, index)
