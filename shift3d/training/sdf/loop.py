"""Resumable loop of decoder training: a decoder, and a table of numbers from which its codes are computed."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.sdf.decoder import Decoder
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import Compute
from shift3d.training.progress import CurvePoint, Report, stop_on_signal

CURVE_STEPS = 100
WARM_STEPS = 200


class DecoderRun(ABC):
    """State of one training: decoder, table, optimiser, step, mean losses, losses since the last mean, seconds.

    table_name: key of the table in the checkpoint. rates: of the network and of the table, see `set_rates`. mixed:
    bfloat16 in the wide layers, where it saves time.
    """

    table_name: str
    rates: tuple[float, float]

    def __init__(self, recipe: Any, decoder: Decoder, table: Tensor, compute: Compute, mixed: bool) -> None:
        self.recipe, self.compute, self.mixed = recipe, compute, mixed
        self.wide_dtype = torch.bfloat16 if mixed and compute.fast_bfloat16 else torch.float32
        self.decoder = decoder.to(compute.device)
        self.table = torch.nn.Parameter(table.to(compute.device))
        groups = [{"params": list(decoder.parameters())}, {"params": [self.table]}]
        self.optimizer = torch.optim.Adam(groups, fused=True)
        self.step = 0
        self.losses: list[float] = []
        self.recent: list[float] = []
        self.began_s = time.monotonic()  # start time of an uninterrupted training

    @abstractmethod
    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return codes (S, code), points (S, P, 3) and distances (S, P) of this step, the same for the same step."""

    def penalty(self) -> Tensor | float:
        """Return the term that is added to the loss of the distances."""
        return 0.0

    def set_rates(self) -> None:
        """Set the learning rates: a short linear warm-up, then a cosine from `rates` to zero."""
        warm = min(1.0, (self.step + 1) / WARM_STEPS)
        share = warm * 0.5 * (1.0 + math.cos(math.pi * self.step / self.recipe.steps))
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * share

    def advance(self) -> float:
        """Run one step. Returns the loss of the distances."""
        self.set_rates()
        clamp = self.recipe.clamp
        codes, points, distances = self.batch()
        predicted = self.decoder.grouped(codes, points, self.wide_dtype)
        data = (predicted.clamp(-clamp, clamp) - distances.clamp(-clamp, clamp)).abs().mean()
        loss = data + self.penalty()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        self.step += 1
        return float(data.detach())

    def state(self) -> dict[str, Any]:
        """Return everything that a resumed training needs."""
        return {
            "recipe": asdict(self.recipe),
            "step": self.step,
            "decoder": self.decoder.state_dict(),
            self.table_name: self.table.detach(),
            "optimizer": self.optimizer.state_dict(),
            "losses": self.losses,
            "recent": self.recent,
            "seconds": time.monotonic() - self.began_s,
            "compute": self.compute.facts(self.mixed),
        }

    def restore(self, state: Mapping[str, Any], where: str) -> None:
        """Continue from a checkpoint of the same recipe. Raises InputError for another recipe."""
        ours, theirs = asdict(self.recipe), state["recipe"]
        names = [name for name in ours | theirs if ours.get(name) != theirs.get(name)]
        if names:
            other = [f"{name}={theirs.get(name)}, not {ours.get(name)}" for name in names]
            what = f"checkpoint of another recipe ({'; '.join(other)})"
            raise InputError(what, where=where, remedy="Give another out=, or delete it")
        self.decoder.load_state_dict(state["decoder"])
        with torch.no_grad():
            self.table.copy_(state[self.table_name])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.losses = int(state["step"]), list(state["losses"])
        self.recent = list(state.get("recent", []))
        self.began_s = time.monotonic() - float(state.get("seconds", 0.0))


def run_to_end(run: DecoderRun, file: Path, every: int, report: Report | None) -> None:
    """Run all remaining steps, from the checkpoint if there is one; replace the checkpoint every `every` steps.

    Raises InputError: the checkpoint is of another recipe, or the loss is not finite; KeyboardInterrupt on SIGINT or
    SIGTERM, after the checkpoint is written.
    """
    if file.is_file():
        run.restore(read_checkpoint(file), str(file))
    steps: int = run.recipe.steps
    curve: list[CurvePoint] = []
    bar = progress_bar(total=steps, initial=run.step, desc="training sdf", unit="step")
    with stop_on_signal() as stop, bar:
        while run.step < steps:
            run.recent.append(run.advance())
            if not math.isfinite(run.recent[-1]):
                remedy = "Give another out=; of meshes, leave out those that are damaged"
                raise InputError(f"the loss of step {run.step} is not finite", str(file), remedy)
            bar.update()
            if run.step % CURVE_STEPS == 0:
                run.losses.append(float(np.mean(run.recent)))
                run.recent = []
                rate = float(run.optimizer.param_groups[0]["lr"])
                curve.append((run.step, {"loss": run.losses[-1], "learning_rate": rate}))
                bar.set_postfix(loss=f"{run.losses[-1]:.5f}", refresh=False)
            if run.step % every == 0 or run.step == steps or stop.is_set():
                write_checkpoint(file, run.state())
                loss = float(np.mean(run.recent)) if run.recent else run.losses[-1]
                bar.write(f"step {run.step} of {steps}  loss {loss:.5f}  ({file.name} written)")
                if report is not None and curve:
                    report(curve)
                curve = []
            if stop.is_set() and run.step < steps:
                raise KeyboardInterrupt
