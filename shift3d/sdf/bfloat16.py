"""Decoder field in bfloat16, for samples far from the surface.

A ray march spends most of its samples in free space, where the value only sets the length of the next step. Eight bits
of mantissa suffice there: against float32 the metric distance of a car is off by 0.7 mm in the median and 7 mm at
most. Coordinates stay in float32 (a coordinate in bfloat16 alone is off by millimetres); the wide layers use bfloat16.
Every value below `bfloat16_band_m` is evaluated again in float32, so a bfloat16 sign never decides a hit.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from shift3d.processor import pad_to_bucket
from shift3d.sdf.affine import active_units


class Bfloat16Field:
    """g(z, .) of a folded decoder, wide layers in bfloat16. Not differentiable. Takes and returns float32.

    weights, biases, skip_layer: see `field.Field`; float32.
    """

    def __init__(self, weights: Sequence[Tensor], biases: Sequence[Tensor], skip_layer: int) -> None:
        self.skip = skip_layer
        weights = [weight.detach() for weight in weights]
        self.biases = [bias.detach() for bias in biases]
        self.first, self.last = weights[0].T, weights[-1].T
        self.at_skip = weights[skip_layer][:, -3:].T
        wide = [w[:, :-3] if layer == skip_layer else w for layer, w in enumerate(weights)]
        self.wide = [w.T.to(torch.bfloat16) for w in wide]
        self.wide_biases = [bias.to(torch.bfloat16) for bias in self.biases]

    def __call__(self, x_sdf: Tensor) -> Tensor:
        return self._evaluate(x_sdf, None)

    def survey(self, x_sdf: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Compute values (N,) at points (N, 3), and a bool mask per layer of the units active at any point."""
        live: list[Tensor] = []
        return self._evaluate(x_sdf, live), live

    @staticmethod
    def _note(units: Tensor, live: list[Tensor] | None) -> None:
        if live is not None:
            live.append(active_units(units))

    def _evaluate(self, x_sdf: Tensor, live: list[Tensor] | None) -> Tensor:
        # Rows are padded to a bucket size: bfloat16 fields exist only where oneDNN computes the products.
        x = torch.nn.functional.pad(x_sdf.float(), (0, 0, 0, pad_to_bucket(len(x_sdf)) - len(x_sdf)))
        hidden = torch.addmm(self.biases[0], x, self.first).relu_().to(torch.bfloat16)
        self._note(hidden[: len(x_sdf)], live)
        for layer in range(1, len(self.wide) - 1):
            if layer == self.skip:
                entry = torch.addmm(self.biases[layer], x, self.at_skip).to(torch.bfloat16)
                hidden = torch.addmm(entry, hidden, self.wide[layer])
            else:
                hidden = torch.addmm(self.wide_biases[layer], hidden, self.wide[layer])
            hidden = hidden.relu_()
            self._note(hidden[: len(x_sdf)], live)
        return torch.tanh(torch.addmm(self.biases[-1], hidden.float(), self.last)[: len(x_sdf), 0])
