"""Training loop of detectors: a fixed number of steps on crops of scenes, resumable to the same weights."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.network import DetectorNet
from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import ONE_THREAD, Compute
from shift3d.training.detector.batches import BatchMaker, Example, batches
from shift3d.training.detector.crop_sampling import RandomCrops
from shift3d.training.detector.crops import Crop
from shift3d.training.detector.objective import batch_loss, objective_of
from shift3d.training.detector.pasting import VehicleDatabase
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector.recipes import one_cycle
from shift3d.training.progress import CurvePoint, Report, mean_values, stop_on_signal


def recompute_statistics(net: DetectorNet, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> None:
    """Set every batch norm's mean and variance to those of this batch, in place; weights stay.

    All crops pass as one batch, and each layer is normalised by that batch: its statistics are those of its input at
    inference. Means over small batches differ, because each small batch is normalised by its own statistics.
    Source: our choice, after the population statistics of Ioffe and Szegedy 2015, section 3.1; Wu and Johnson 2021
    measure the loss from running means.
    """
    norms = [module for module in net.modules() if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d)]
    momenta = [norm.momentum for norm in norms]
    was_training = net.training
    net.train()
    for norm in norms:
        norm.momentum = 1.0
    with torch.no_grad(), torch.autocast(clouds[0].device.type, enabled=False):
        net.features(clouds, windows)
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
    net.train(was_training)


CHECKPOINT = "checkpoint.pt"
SHIPPED_DATA = "street"
CURVE_STEPS = 25  # steps per curve point; a point is the mean over these steps


def own_checkpoint(file: Path, recipe: Recipe, data: str) -> dict[str, Any] | None:
    """Read the checkpoint of a training; None if there is none. recipe, data: as for `train_on_scenes`.

    Raises: InputError: the checkpoint is of another recipe, other scenes or another start, or cannot be read.
    """
    if not file.is_file():
        return None
    state = read_checkpoint(file)
    how = ""
    if state.get("recipe") != repr(recipe):
        other = _fields_missing(recipe, str(state.get("recipe")))
        how = f"by another recipe than {', '.join(other) or 'this'}"
    elif state.get("data", SHIPPED_DATA) != data:  # checkpoints without `data` are of the shipped streets
        how = "on another set of scenes, or from other weights"
    if how:
        raise InputError(f"the checkpoint was trained {how}", str(file), remedy="Choose another folder with out=")
    return state


def _fields_missing(recipe: Recipe, text: str) -> list[str]:
    """Return the fields of a recipe whose values the text of another recipe does not hold, as on a command line."""
    values = {**vars(recipe), **vars(recipe.augmentation)}
    return [
        f"recipe.{name}={value}"
        for name, value in values.items()
        if name != "augmentation" and not re.search(rf"[( ]{name}={re.escape(repr(value))}[,)]", text)
    ]


class _Run:
    """State of one training: network, optimiser, steps done, curve, steps since its last point, and seconds."""

    def __init__(
        self, file: Path, recipe: Recipe, compute: Compute, data: str, start: Mapping[str, Any] | None
    ) -> None:
        torch.manual_seed(recipe.seed)
        self.file, self.recipe, self.compute, self.data = file, recipe, compute, data
        self.net = recipe.new_network()
        self.objective = objective_of(recipe)
        if start is not None:
            self.net.load_state_dict(dict(start))
        self.net.to(compute.device)
        if compute.fast_bfloat16 and recipe.bfloat16:  # in float32 on a CPU this layout is slower
            self.net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.AdamW(self.net.parameters(), lr=recipe.peak_rate, weight_decay=recipe.weight_decay)
        self.done = 0
        self.curve: list[CurvePoint] = []
        self.recent: list[dict[str, float]] = []
        self.reported = 0
        self.steps_by_device: dict[str, int] = {}
        # The start time of an uninterrupted training.
        self.began_s = time.monotonic() - self._resume()

    def _resume(self) -> float:
        state = own_checkpoint(self.file, self.recipe, self.data)
        if state is None:
            return 0.0
        self.net.load_state_dict(state["net"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.done = int(state["steps_done"])
        self.curve = [(int(step), values) for step, values in state.get("curve", [])]
        self.recent = list(state.get("recent", []))
        self.reported = len(self.curve)
        self.steps_by_device = dict(state.get("steps_by_device", {}))
        return float(state.get("seconds", 0.0))

    def save(self, report: Report | None) -> None:
        """Replace the checkpoint, then report the curve points since the last checkpoint."""
        state = {
            "steps_done": self.done,
            "recipe": repr(self.recipe),
            "data": self.data,
            "net": self.net.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "curve": [[step, dict(values)] for step, values in self.curve],
            "recent": self.recent,
            "seconds": time.monotonic() - self.began_s,
            "steps_by_device": self.steps_by_device,
        }
        write_checkpoint(self.file, state)
        if report is not None and len(self.curve) > self.reported:
            report(self.curve[self.reported :])
        self.reported = len(self.curve)


def train_on_scenes(
    out_dir: Path,
    recipe: Recipe,
    mesh_scenes: Sequence[Path],
    inserted_scenes: Sequence[Path] = (),
    checkpoint_every: int = 250,
    stop_after: int | None = None,
    compute: Compute = ONE_THREAD,
    report: Report | None = None,
    data: str = SHIPPED_DATA,
    start: Mapping[str, Any] | None = None,
    draw: type[RandomCrops] = RandomCrops,
    keep_statistics: bool = False,
) -> DetectorNet:
    """Train to recipe.all_steps, or to stop_after (to be resumed); resume from out_dir's checkpoint if there is one.

    A resumed training gives the weights of an uninterrupted one: the crops of a step depend on the seed and the step
    alone. A checkpoint replaces the last one every `checkpoint_every` steps, and when SIGINT or SIGTERM asks to stop.

    Args:
        mesh_scenes, inserted_scenes: cached scenes without and with rendered insertions.
        compute: default the CPU, one thread. report: called with the curves' points after every checkpoint.
        data: identifies the scenes and the weights at the start; a checkpoint of others is refused.
        start: a state dict to start from instead of random weights. draw: class that chooses a step's crops.
        keep_statistics: batch norms compute as at inference from the first step, with the statistics of `start`.
    Returns: the network on its device, in evaluation mode.
    Raises: InputError if the recipe is invalid, the checkpoint is of another recipe, scenes or start, or the loss is
    not finite; KeyboardInterrupt on SIGINT or SIGTERM, after the checkpoint is written.
    """
    recipe.validate()
    compute.prepare()
    out_dir.mkdir(parents=True, exist_ok=True)
    run = _Run(out_dir / CHECKPOINT, recipe, compute, data, start)
    run.net.train(not keep_statistics)
    end = recipe.all_steps if stop_after is None else min(recipe.all_steps, stop_after)
    pasting = recipe.augmentation.pasted > 0 and end > 0
    database = VehicleDatabase.of(mesh_scenes, recipe.min_points, compute.scene_workers) if pasting else None
    crops = draw(recipe, run.net.grid, mesh_scenes, inserted_scenes, database)
    maker = BatchMaker(crops, run.objective, run.net)
    bar = progress_bar(initial=run.done, total=recipe.all_steps, desc=recipe.detector, unit="step")
    with stop_on_signal() as stop, bar:
        for step, examples in batches(maker, range(run.done, end), compute.crop_workers):
            if step >= recipe.steps:
                _freeze_backbone(run, crops.of_statistics())
            run.recent.append(_train_step(run, step, examples))
            run.done = step + 1
            run.steps_by_device[compute.name] = run.steps_by_device.get(compute.name, 0) + 1
            bar.update()
            if run.done % CURVE_STEPS == 0 or run.done == end:
                run.curve.append((run.done, mean_values(run.recent)))
                run.recent = []
            if run.done % checkpoint_every == 0 or run.done == end or stop.is_set():
                run.save(report)
                last = run.curve[-1][1] if run.curve else {}
                shown = "  ".join(f"{name} {value:.3g}" for name, value in last.items())
                bar.write(f"step {run.done} of {recipe.all_steps}  {shown}  ({CHECKPOINT} written)")
            if stop.is_set() and run.done < recipe.all_steps:
                raise KeyboardInterrupt
    if run.done == recipe.steps == recipe.all_steps:  # no settle steps: only the statistics are computed
        if not run.done:  # no step wrote the checkpoint, whose facts the provenance holds
            run.save(report)
        _freeze_backbone(run, crops.of_statistics())
    return run.net.eval().requires_grad_(True)


def _freeze_backbone(run: _Run, crops: Iterator[Crop]) -> None:
    """Compute the batch norm statistics once, then freeze all but the heads: features are as at inference."""
    if run.recipe.statistics_crops and run.done == run.recipe.steps:
        chosen = list(islice(crops, run.recipe.statistics_crops))
        clouds = [torch.from_numpy(crop.points).to(run.compute.device) for crop in chosen]
        recompute_statistics(run.net, clouds, [crop.window for crop in chosen])
    run.net.eval().requires_grad_(False)
    run.net.heads.requires_grad_(True)


def _train_step(run: _Run, step: int, examples: list[Example]) -> dict[str, float]:
    """Run one optimiser step. Returns loss parts and learning rate. Raises InputError for a loss that is not finite."""
    recipe, device = run.recipe, run.compute.device
    rate, momentum = one_cycle(step, recipe)
    for group in run.optimiser.param_groups:
        group["lr"], group["betas"] = rate, (momentum, 0.99)
    examples = [example.each(lambda part: part.to(device)) for example in examples]
    clouds, windows, pillars = zip(*((own.points, own.window, own.pillars) for own in examples), strict=True)
    with run.compute.autocast(recipe.bfloat16):
        features = run.net.features(clouds, windows, pillars)
        loss, parts = batch_loss(run.objective, run.net.heads, features, [own.targets for own in examples])
    if not all(map(math.isfinite, parts.values())):  # the step would make every weight NaN
        remedy = "Give a smaller recipe.peak_rate=, and another out="
        raise InputError(f"the loss of step {step + 1} is not finite", str(run.file), remedy)
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), recipe.clip_norm)
    run.optimiser.step()
    return {**parts, "learning_rate": rate}
