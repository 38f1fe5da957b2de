"""Training of a decoder whose codes are a linear map of the generator's parameters: z = features @ basis.

Codes of an auto-decoder hold whatever lowers the loss; a part of theirs says nothing about vehicles, and attacks go
there. Here a code holds the vehicle's parameters and nothing else, and vehicles that were never trained on have one.
Source: our choice. Loss, optimiser and samples are DeepSDF's (Park et al. 2019, section 4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from shift3d.sdf.decoder import Architecture, Decoder, load_decoder
from shift3d.seeding import derive_seed
from shift3d.training.compute import Compute
from shift3d.training.progress import Report
from shift3d.training.sdf.loop import DecoderRun, run_to_end
from shift3d.training.sdf.wide_shapes import WideShapes, wide_shapes, wide_specs

CHECKPOINT = "parametric.pt"


@dataclass(frozen=True)
class ParametricRecipe:
    """Everything that decides the weights, beside the samples.

    shapes, samples_a_shape: vehicles, half seen and half held out. shapes_a_step, points_a_shape: of a batch.
    start: "shipped" for the shipped decoder's network, "" for random weights. basis_std: of the basis' first values.
    """

    shapes: int = 1200
    samples_a_shape: int = 16_000
    shapes_a_step: int = 360
    points_a_shape: int = 24
    steps: int = 5_000
    seed: int = 7
    network_rate: float = 8e-4
    basis_rate: float = 8e-4
    clamp: float = 0.1
    basis_std: float = 0.01
    start: str = "shipped"
    bfloat16: bool = True


class ParametricRun(DecoderRun):
    """One training of a decoder and the basis that makes codes of features."""

    table_name = "basis"

    def __init__(self, recipe: ParametricRecipe, shapes: WideShapes, compute: Compute) -> None:
        torch.manual_seed(derive_seed("parametric sdf training", recipe.seed) % 2**63)
        decoder = Decoder(Architecture())
        if recipe.start == "shipped":
            _take_weights(decoder, load_decoder())
        basis = torch.randn(shapes.features.shape[1], decoder.architecture.code_length) * recipe.basis_std
        self.shapes, self.rates = shapes, (recipe.network_rate, recipe.basis_rate)
        super().__init__(recipe, decoder, basis, compute, recipe.bfloat16)

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        recipe, shapes = self.recipe, self.shapes
        rng = np.random.default_rng([recipe.seed, self.step])
        chosen = np.sort(rng.choice(len(shapes.features), recipe.shapes_a_step, replace=False))
        start = int(rng.integers(shapes.points.shape[1] - recipe.points_a_shape + 1))
        taken = slice(start, start + recipe.points_a_shape)
        points = shapes.points[chosen, taken].copy()
        mirrored = shapes.symmetric[chosen, None] & (rng.random(points.shape[:2]) < 0.5)
        points[..., 1] = np.where(mirrored, -points[..., 1], points[..., 1])
        arrays = (shapes.features[chosen], points, shapes.distances[chosen, taken].copy())
        features, tensor, target = (torch.from_numpy(array).to(self.compute.device) for array in arrays)
        return features @ self.table, tensor, target


def _take_weights(decoder: Decoder, start: Decoder) -> None:
    """Let a decoder with weight norm compute what a folded one does."""
    with torch.no_grad():
        for layer, other in zip(decoder.layers, start.layers, strict=True):
            assert isinstance(other.weight, Tensor)
            assert isinstance(other.bias, Tensor)
            layer.weight = other.weight.detach().clone()
            assert isinstance(layer.bias, Tensor)
            layer.bias.copy_(other.bias)


def train_parametric(
    out: Path,
    recipe: ParametricRecipe,
    shapes: WideShapes,
    compute: Compute,
    checkpoint_every: int = 250,
    report: Report | None = None,
) -> Path:
    """Train, or go on with a training, and leave the checkpoint (decoder, basis, recipe) in `out`; returns its path.

    Raises: InputError when `out` holds another recipe's training; KeyboardInterrupt when asked to stop.
    """
    compute.prepare()
    file = out / CHECKPOINT
    run_to_end(ParametricRun(recipe, shapes, compute), file, checkpoint_every, report)
    return file


def train_wide(
    out: Path, compute: Compute, count: int | None = None, steps: int | None = None, report: Report | None = None
) -> list[float]:
    """Sample the wide family, train, and leave the vehicle set in `out`; returns its Chamfer distances in cm.

    count, steps: None for the recipe's. Raises: InputError where `out` holds another training, or no kind has
    vehicles enough to be measured.
    """
    from shift3d.training.sdf.parametric_export import export_parametric, members_by_kind

    recipe = ParametricRecipe()
    recipe = replace(recipe, shapes=count or recipe.shapes, steps=steps or recipe.steps)
    recipe = replace(recipe, shapes_a_step=min(recipe.shapes_a_step, recipe.shapes))
    members_by_kind(wide_specs(recipe.shapes, recipe.seed))  # too few are known before anything is made
    shapes = wide_shapes(recipe.shapes, recipe.samples_a_shape, recipe.seed, out / "shapes", compute.threads)
    checkpoint = train_parametric(out, recipe, shapes, compute, report=report)
    return list(export_parametric(checkpoint, shapes, out).values())
