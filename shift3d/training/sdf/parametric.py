"""Training of a decoder whose codes are a linear map of the generator's parameters: z = features @ basis.

Codes of an auto-decoder hold whatever lowers the loss; a part of theirs says nothing about vehicles, and attacks go
there. Here a code holds the vehicle's parameters and nothing else, and vehicles that were never trained on have one.
Source: our choice. Loss, optimiser and samples are DeepSDF's (Park et al. 2019, section 4).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder, load_decoder
from shift3d.seeding import derive_seed
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import Compute
from shift3d.training.progress import CurvePoint, Report, Stopwatch, stop_on_signal
from shift3d.training.sdf.wide_shapes import WideShapes, wide_shapes

CHECKPOINT = "parametric.pt"
CURVE_STEPS = 100


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


class _Run:
    def __init__(self, recipe: ParametricRecipe, shapes: WideShapes, compute: Compute) -> None:
        self.recipe, self.shapes, self.device = recipe, shapes, compute.device
        mixed = recipe.bfloat16 and compute.fast_bfloat16
        self.wide_dtype = torch.bfloat16 if mixed else torch.float32
        torch.manual_seed(derive_seed("parametric sdf training", recipe.seed) % 2**63)
        self.decoder = Decoder(Architecture())
        if recipe.start == "shipped":
            _take_weights(self.decoder, load_decoder())
        self.decoder.to(self.device)
        length = self.decoder.architecture.code_length
        basis = torch.randn(shapes.features.shape[1], length) * recipe.basis_std
        self.basis = torch.nn.Parameter(basis.to(self.device))
        groups = [
            {"params": list(self.decoder.parameters()), "lr": recipe.network_rate, "peak": recipe.network_rate},
            {"params": [self.basis], "lr": recipe.basis_rate, "peak": recipe.basis_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, fused=True)
        self.step = 0
        self.losses: list[float] = []
        self.watch = Stopwatch()

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """Features (S, F), points (S, P, 3) and distances (S, P) of this step, the same for the same step."""
        recipe, shapes = self.recipe, self.shapes
        rng = np.random.default_rng([recipe.seed, self.step])
        chosen = np.sort(rng.choice(len(shapes.features), recipe.shapes_a_step, replace=False))
        start = int(rng.integers(shapes.points.shape[1] - recipe.points_a_shape + 1))
        taken = slice(start, start + recipe.points_a_shape)
        points = shapes.points[chosen, taken].copy()
        mirrored = shapes.symmetric[chosen, None] & (rng.random(points.shape[:2]) < 0.5)
        points[..., 1] = np.where(mirrored, -points[..., 1], points[..., 1])
        distances = shapes.distances[chosen, taken].copy()
        arrays = (shapes.features[chosen], points, distances)
        features, tensor, target = (torch.from_numpy(array).to(self.device) for array in arrays)
        return features, tensor, target

    def advance(self) -> float:
        """One step; returns the loss."""
        recipe = self.recipe
        warm = min(1.0, (self.step + 1) / 200)
        for group in self.optimizer.param_groups:
            group["lr"] = group["peak"] * warm * 0.5 * (1.0 + math.cos(math.pi * self.step / recipe.steps))
        features, points, distances = self.batch()
        predicted = self.decoder.grouped(features @ self.basis, points, self.wide_dtype)
        target = distances.clamp(-recipe.clamp, recipe.clamp)
        loss = (predicted.clamp(-recipe.clamp, recipe.clamp) - target).abs().mean()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        self.step += 1
        return float(loss.detach())

    def state(self) -> dict[str, Any]:
        return {
            "recipe": asdict(self.recipe),
            "step": self.step,
            "decoder": self.decoder.state_dict(),
            "basis": self.basis.detach(),
            "optimizer": self.optimizer.state_dict(),
            "losses": self.losses,
            "seconds": self.watch.seconds,
        }

    def restore(self, state: dict[str, Any], where: str) -> None:
        if state["recipe"] != asdict(self.recipe):
            raise InputError("checkpoint of another recipe", where=where, remedy="another out=, or delete it")
        self.decoder.load_state_dict(state["decoder"])
        with torch.no_grad():
            self.basis.copy_(state["basis"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.losses = int(state["step"]), list(state["losses"])
        self.watch = Stopwatch(float(state["seconds"]))


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
    run = _Run(recipe, shapes, compute)
    file = out / CHECKPOINT
    state = read_checkpoint(file)
    if state is not None:
        run.restore(state, str(file))
    recent: list[float] = []
    curve: list[CurvePoint] = []
    bar = tqdm(total=recipe.steps, initial=run.step, desc="training sdf", mininterval=10.0)
    with stop_on_signal() as stop, bar:
        while run.step < recipe.steps:
            recent.append(run.advance())
            bar.update()
            if run.step % CURVE_STEPS == 0:
                run.losses.append(float(np.mean(recent)))
                curve.append((run.step, {"loss": run.losses[-1]}))
                bar.set_postfix(loss=f"{run.losses[-1]:.5f}", refresh=False)
                recent = []
            if run.step % checkpoint_every == 0 or run.step == recipe.steps or stop.requested:
                write_checkpoint(file, run.state())
                if report is not None and curve:
                    report(curve)
                curve = []
            if stop.requested and run.step < recipe.steps:
                raise KeyboardInterrupt
    return file


def train_wide(
    out: Path, compute: Compute, count: int | None = None, steps: int | None = None, report: Report | None = None
) -> list[float]:
    """Sample the wide family, train, and leave the vehicle set in `out`; returns its Chamfer distances in cm.

    count, steps: None for the recipe's. Raises: InputError where `out` holds another training.
    """
    from shift3d.training.sdf.parametric_export import export_parametric

    recipe = ParametricRecipe()
    recipe = replace(recipe, shapes=count or recipe.shapes, steps=steps or recipe.steps)
    recipe = replace(recipe, shapes_a_step=min(recipe.shapes_a_step, recipe.shapes))
    shapes = wide_shapes(recipe.shapes, recipe.samples_a_shape, recipe.seed, out / "shapes", compute.threads)
    checkpoint = train_parametric(out, recipe, shapes, compute, report=report)
    return list(export_parametric(checkpoint, shapes, out).values())
