"""A small decoder of full code length that draws about an octahedron, for what holds for any decoder."""

from __future__ import annotations

import torch

from shift3d.sdf.decoder import Architecture, Decoder


def octahedron_decoder(seed: int = 0) -> Decoder:
    """Return a folded decoder g ~ tanh(0.5 (|x| + |y| + |z|) - 0.3) that every number of a code changes a little."""
    torch.manual_seed(seed)
    decoder = Decoder(Architecture(width=264, hidden_layers=2, skip_layer=1)).folded()
    _, middle, last = decoder.layers
    with torch.no_grad():
        last.weight.mul_(0.1)
        last.bias.fill_(-0.3)
        last.weight[0, :6] = 0.5
        middle.weight[:6] = 0.0
        middle.bias[:6] = 0.0
        for row in range(6):
            middle.weight[row, -3 + row // 2] = (-1.0) ** row
    return decoder
