"""Training of the DeepSDF auto-decoder, on the family of vehicles or on the samples of any meshes.

Source: Park et al. 2019, section 4 and supplement (SHIFT3D trains "as the original DeepSDF paper"): clamped L1 with
delta 0.1, 1e-4 times the squared norm of the codes, ramped in, codes drawn from N(0, 0.01^2), Adam with 5e-4 for
the network and 1e-3 for the codes, weight norm. Ours, for a training of an hour on two cores: every step sees every
shape, the learning rate falls as a cosine, no dropout, the wide layers run in bfloat16 over float32 weights, and
vehicles of the family are mirrored at random, being symmetric.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder
from shift3d.seeding import derive_seed
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import Compute, choose_compute
from shift3d.training.progress import CurvePoint, Report, Stopwatch, stop_on_signal
from shift3d.training.sdf_shapes import ShapeSamples, shape_samples

CURVE_STEPS = 100


@dataclass(frozen=True)
class SdfRecipe:
    """Everything that decides the weights; two trainings of one recipe with as many threads agree.

    source: "family", or what identifies the meshes that the shapes come from (`ShapeSamples.source`).
    mirror: whether left and right are swapped at random; only for shapes that are symmetric.
    """

    shapes: int = 270
    samples_a_shape: int = 100_000
    batch_a_shape: int = 32
    steps: int = 9_000
    seed: int = 7
    network_rate: float = 5e-4
    code_rate: float = 1e-3
    clamp: float = 0.1
    code_penalty: float = 1e-4
    penalty_ramp: float = 0.05
    code_init_std: float = 0.01
    compute: str = "bfloat16"
    source: str = "family"
    mirror: bool = True


# What the recipe of a checkpoint from before these fields says.
_BEFORE_MESHES = {"source": "family", "mirror": True}


class _Run:
    """The state of one training: decoder, codes, optimiser, step."""

    def __init__(self, recipe: SdfRecipe, compute: Compute | None = None) -> None:
        self.compute = compute or choose_compute("cpu")
        # Mixed precision only where it pays; which it was stands in the checkpoint.
        mixed = recipe.compute == "bfloat16" and self.compute.fast_bfloat16
        self.wide_dtype = torch.bfloat16 if mixed else torch.float32
        torch.manual_seed(derive_seed("sdf training", recipe.seed) % 2**63)
        self.recipe = recipe
        self.decoder = Decoder(Architecture()).to(self.compute.device)
        codes = torch.randn(recipe.shapes, self.decoder.architecture.code_length) * recipe.code_init_std
        self.codes = torch.nn.Parameter(codes.to(self.compute.device))
        groups = [
            {"params": list(self.decoder.parameters()), "lr": recipe.network_rate},
            {"params": [self.codes], "lr": recipe.code_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, fused=True)
        self.step = 0
        self.losses: list[float] = []
        self.watch = Stopwatch()
        self.note = "one schedule from the first step to the last"

    def set_rates(self) -> None:
        """Cosine from the published rates to nothing, after a short linear start."""
        warm = min(1.0, (self.step + 1) / 200)
        share = warm * 0.5 * (1.0 + math.cos(math.pi * self.step / self.recipe.steps))
        rates = (self.recipe.network_rate, self.recipe.code_rate)
        for group, rate in zip(self.optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * share

    def advance(self, points: Tensor, distances: Tensor) -> float:
        """One step on points (S, P, 3) and distances (S, P) of all shapes; returns the data loss."""
        recipe, device = self.recipe, self.compute.device
        points, distances = points.to(device), distances.to(device)
        self.set_rates()
        predicted = self.decoder.grouped(self.codes, points, self.wide_dtype)
        target = distances.clamp(-recipe.clamp, recipe.clamp)
        data = (predicted.clamp(-recipe.clamp, recipe.clamp) - target).abs().mean()
        ramp = min(1.0, self.step / (recipe.penalty_ramp * recipe.steps))
        loss = data + recipe.code_penalty * ramp * self.codes.square().sum(dim=1).mean()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        self.step += 1
        return float(data.detach())

    def state(self) -> dict[str, Any]:
        """What a resumed training needs."""
        return {
            "recipe": asdict(self.recipe),
            "step": self.step,
            "decoder": self.decoder.state_dict(),
            "codes": self.codes.detach(),
            "optimizer": self.optimizer.state_dict(),
            "losses": self.losses,
            "note": self.note,
            "seconds": self.watch.seconds,
            "compute": self.compute.facts(self.recipe.compute == "bfloat16"),
        }

    def restore(self, state: dict[str, Any], where: str) -> None:
        """Continue from a checkpoint of the same recipe. Raises InputError for another recipe."""
        if {**_BEFORE_MESHES, **state["recipe"]} != asdict(self.recipe):
            raise InputError("checkpoint of another recipe", where=where, remedy="another out=, or delete it")
        self.decoder.load_state_dict(state["decoder"])
        with torch.no_grad():
            self.codes.copy_(state["codes"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.losses = int(state["step"]), list(state["losses"])
        self.note = str(state.get("note", self.note))
        self.watch = Stopwatch(float(state.get("seconds", 0.0)))

    def curve_point(self) -> CurvePoint:
        """The last hundred steps' mean loss, and the network's learning rate."""
        return self.step, {"loss": self.losses[-1], "learning_rate": float(self.optimizer.param_groups[0]["lr"])}


def _batch(samples: ShapeSamples, recipe: SdfRecipe, step: int) -> tuple[Tensor, Tensor]:
    """Batch of one step: the same for the same step, so that a resumed training sees what it would have seen."""
    rng = np.random.default_rng([recipe.seed, step])
    start = int(rng.integers(samples.points.shape[1] - recipe.batch_a_shape))
    chosen = slice(start, start + recipe.batch_a_shape)
    points = torch.from_numpy(samples.points[:, chosen].copy())
    if recipe.mirror:
        points[..., 1] *= torch.from_numpy(rng.choice(np.array([-1.0, 1.0], np.float32), points.shape[:2]))
    return points, torch.from_numpy(samples.distances[:, chosen].copy())


def train_sdf(
    out_dir: Path | str,
    recipe: SdfRecipe | None = None,
    threads: int = 1,
    checkpoint_every: int = 1000,
    samples: ShapeSamples | None = None,
    compute: Compute | None = None,
    report: Report | None = None,
) -> Path:
    """Train, or go on with a training, and leave `sdf.pt` (decoder, codes, recipe) in `out_dir`.

    Args:
        out_dir: holds the sampled shapes, the checkpoint and `progress.json`; the same folder and recipe resume.
        recipe: default the shipped one.
        threads: of the arithmetic; another number rounds differently and changes nothing else.
        checkpoint_every: steps between checkpoints; no influence on the result. SIGINT and SIGTERM also write one.
        samples: of the shapes to train on; default the family's. The recipe's `shapes` and `source` are then theirs.
        compute: default the CPU with `threads` threads. report: is given the curve's points after every checkpoint.
    Returns: the finished checkpoint.
    Raises: InputError when `out_dir` holds another recipe's training; KeyboardInterrupt when asked to stop.
    Source: Park et al. 2019, section 4; see the module for what is ours.
    """
    recipe = recipe or SdfRecipe()
    out = Path(out_dir)
    compute = compute or choose_compute("cpu", threads)
    compute.prepare()
    if samples is None:
        samples = shape_samples(recipe.shapes, recipe.samples_a_shape, recipe.seed, out / "shapes", threads)
    if (len(samples.points), samples.source) != (recipe.shapes, recipe.source):
        raise InputError("samples of other shapes than the recipe's", where=str(out), remedy="those of its source")
    run = _Run(recipe, compute)
    file = out / "sdf.pt"
    state = read_checkpoint(file)
    if state is not None:
        run.restore(state, str(file))
    _advance_to_end(run, samples, file, checkpoint_every, report)
    return file


def _advance_to_end(run: _Run, samples: ShapeSamples, file: Path, every: int, report: Report | None) -> None:
    """All steps that are left, with checkpoints."""
    steps = run.recipe.steps
    recent: list[float] = []
    curve: list[CurvePoint] = []
    bar = tqdm(total=steps, initial=run.step, desc="training sdf", mininterval=10.0)
    with stop_on_signal() as stop, bar:
        while run.step < steps:
            recent.append(run.advance(*_batch(samples, run.recipe, run.step)))
            bar.update()
            if run.step % CURVE_STEPS == 0:
                run.losses.append(float(np.mean(recent)))
                curve.append(run.curve_point())
                bar.set_postfix(loss=f"{run.losses[-1]:.5f}", refresh=False)
                recent = []
            if run.step % every == 0 or run.step == steps or stop.requested:
                write_checkpoint(file, run.state())
                loss = run.losses[-1] if run.losses else None
                (file.parent / "progress.json").write_text(json.dumps({"step": run.step, "of": steps, "loss": loss}))
                tqdm.write(f"step {run.step} of {steps}  loss {loss}  ({file.name} written)")
                if report is not None and curve:
                    report(curve)
                curve = []
            if stop.requested and run.step < steps:
                raise KeyboardInterrupt
