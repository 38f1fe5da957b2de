"""Auto-decoding: search for the latent code of an unseen shape by Adam on z with a frozen decoder."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.processor import has_fast_bfloat16
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.samples import SdfSamples
from shift3d.seeding import derive_seed

RATE, CODE_PENALTY = 1.5e-2, 1e-5
"""Published values (5e-3, 1e-4) rescaled to the shipped codes, which are three times as long as trained."""
CLAMP = 0.1  # distances are clamped to this absolute value, as in training


def autodecode(decoder: Decoder, samples: SdfSamples, steps: int = 400, batch: int = 2048, seed: int = 0) -> Tensor:
    """Find a latent code (code,) float32 that explains the samples.

    Args:
        decoder: frozen decoder; not changed.
        samples: of the shape, in its own unit sphere and with the decoder's axes.
        steps, batch: Adam on z; the rate falls to a tenth after half the steps, as published (there with twice the
            steps and four times the points). The wide layers run in bfloat16 if the processor supports it natively.
        seed: of the first code, N(0, 0.01^2), and of the batches.
    Differentiable w.r.t.: nothing. Source: Park et al. 2019, section 4.2 (auto-decoder inference).
    """
    points, distances = torch.from_numpy(samples.points)[None], torch.from_numpy(samples.distances)
    return autodecode_each(decoder, points, distances, steps, batch, seed)[0]


def autodecode_each(
    decoder: Decoder, points: Tensor, distances: Tensor, steps: int, batch: int, seed: int = 0
) -> Tensor:
    """Find latent codes (shapes, code) float32 of several shapes at once whose samples share their distances.

    Args:
        points: (shapes, N, 3) float32, sdf frame, e.g. one shape's samples in several orientations.
        distances: (N,) float32, sdf units, negative inside.
        others: see :func:`autodecode`; all shapes get the same first code and the same batches.
    Differentiable w.r.t.: nothing.
    """
    compute_dtype = torch.bfloat16 if has_fast_bfloat16() else torch.float32
    source = torch.Generator().manual_seed(derive_seed("autodecode", seed) % 2**63)
    first = 0.01 * torch.randn(decoder.architecture.code_length, generator=source)
    z = first.repeat(len(points), 1).requires_grad_(True)
    optimizer = torch.optim.Adam([z], lr=RATE)
    for step in range(steps):
        if step == steps // 2:
            optimizer.param_groups[0]["lr"] = RATE / 10.0
        chosen = torch.randint(len(distances), (batch,), generator=source)
        predicted = decoder.grouped(z, points[:, chosen], compute_dtype).clamp(-CLAMP, CLAMP)
        data = (predicted - distances[chosen].clamp(-CLAMP, CLAMP)).abs().mean(dim=1)
        loss = data.sum() + CODE_PENALTY * z.square().sum()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    return z.detach()
