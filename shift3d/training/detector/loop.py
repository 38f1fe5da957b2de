"""The loop of detector training: a fixed number of steps on crops of scenes, resumable to the same weights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from shift3d.detectors.models.anchors import WAYMO_ANCHORS, anchor_boxes
from shift3d.detectors.models.network import DetectorNet
from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import Compute, choose_compute
from shift3d.training.detector.augmentation import Crop, random_crop
from shift3d.training.detector.losses import detection_loss
from shift3d.training.detector.recipe import Recipe, one_cycle
from shift3d.training.detector.targets import Targets, assign_targets
from shift3d.training.detector_scenes import load_cached
from shift3d.training.progress import CurvePoint, Report, Stopwatch, stop_on_signal

__all__ = ["CHECKPOINT", "SHIPPED_DATA", "train_on_scenes"]

CHECKPOINT = "checkpoint.pt"
SHIPPED_DATA = "street"
CURVE_STEPS = 25
"""Every so many steps the curves get a point; it is the mean over them."""

Batch = tuple[int, list[Crop], list[Targets]]


class _Run:
    """The state of one training: network, optimiser, steps done, curves and seconds."""

    def __init__(
        self, file: Path, recipe: Recipe, compute: Compute, data: str, start: Mapping[str, Any] | None
    ) -> None:
        torch.manual_seed(recipe.seed)
        self.file, self.recipe, self.compute, self.data = file, recipe, compute, data
        self.net = recipe.new_network()
        if start is not None:
            self.net.load_state_dict(dict(start))
        self.net.to(compute.device)
        if compute.fast_bfloat16 and recipe.bfloat16:  # in float32 on a processor this layout is the slower one
            self.net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.AdamW(self.net.parameters(), lr=recipe.peak_rate, weight_decay=recipe.weight_decay)
        self.done = 0
        self.curve: list[CurvePoint] = []
        self.reported = 0
        seconds = self._resume()
        self.watch = Stopwatch(seconds)

    def _resume(self) -> float:
        state = read_checkpoint(self.file)
        if state is None:
            return 0.0
        for key, ours, what in (("recipe", repr(self.recipe), "recipe"), ("data", self.data, "set of scenes")):
            # Checkpoints from before `data` was written are of the shipped streets.
            if state.get(key, SHIPPED_DATA) != ours:
                raise InputError(
                    f"the checkpoint was trained by another {what}", str(self.file), remedy="choose another folder"
                )
        self.net.load_state_dict(state["net"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.done = int(state["steps_done"])
        self.curve = [(int(step), values) for step, values in state.get("curve", [])]
        self.reported = len(self.curve)
        return float(state.get("seconds", 0.0))

    def save(self, report: Report | None) -> None:
        """Replace the checkpoint, then report the curve's points since the last one."""
        state = {
            "steps_done": self.done,
            "recipe": repr(self.recipe),
            "data": self.data,
            "net": self.net.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "curve": [[step, dict(values)] for step, values in self.curve],
            "seconds": self.watch.seconds,
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
    threads: int = 1,
    checkpoint_every: int = 250,
    stop_after: int | None = None,
    compute: Compute | None = None,
    report: Report | None = None,
    data: str = SHIPPED_DATA,
    start: Mapping[str, Any] | None = None,
) -> DetectorNet:
    """Train, or go on from out_dir's checkpoint, to recipe.all_steps (or stop_after, to be resumed).

    A resumed training gives the weights of an uninterrupted one: the crops of a step depend on the seed and
    the step alone. Every `checkpoint_every` steps a checkpoint replaces the last one; so it does when SIGINT or
    SIGTERM asks to stop.

    Args:
        mesh_scenes, inserted_scenes: cached scenes without and with rendered insertions.
        compute: default the CPU with `threads` threads.
        report: is given the curves' points after every checkpoint.
        data: what identifies the scenes; a checkpoint of others is refused.
        start: a state dict to start from instead of random weights.
    Returns: the network on its device, in evaluation mode.
    Raises: InputError if the checkpoint belongs to another recipe or other scenes; KeyboardInterrupt when asked to
        stop, the checkpoint being written.
    """
    compute = compute or choose_compute("cpu", threads)
    compute.prepare()
    out_dir.mkdir(parents=True, exist_ok=True)
    run = _Run(out_dir / CHECKPOINT, recipe, compute, data, start)
    run.net.train()
    end = recipe.all_steps if stop_after is None else min(recipe.all_steps, stop_after)
    recent: list[dict[str, float]] = []
    batches = _batches(run.net, recipe, range(run.done, end), mesh_scenes, inserted_scenes, compute.crops_ahead)
    bar = tqdm(initial=run.done, total=recipe.all_steps, desc=recipe.detector, mininterval=5.0)
    with stop_on_signal() as stop, bar:
        for step, crops, targets in batches:
            recent.append(_train_step(run, step, crops, targets))
            run.done = step + 1
            bar.update()
            if run.done % CURVE_STEPS == 0 or run.done == end:
                run.curve.append((run.done, _mean(recent)))
                recent = []
            if run.done % checkpoint_every == 0 or run.done == end or stop.asked:
                run.save(report)
                shown = "  ".join(
                    f"{name} {value:.3g}" for name, value in (run.curve[-1][1] if run.curve else {}).items()
                )
                tqdm.write(f"step {run.done} of {recipe.all_steps}  {shown}  ({CHECKPOINT} written)")
            if stop.asked and run.done < recipe.all_steps:
                raise KeyboardInterrupt
    return run.net.eval().requires_grad_(True)


def _mean(parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each value over steps."""
    return {name: sum(part[name] for part in parts) / len(parts) for name in parts[-1]}


def _settle(net: DetectorNet) -> None:
    """From here on the network is as at inference but for the heads that draw boxes."""
    net.eval().requires_grad_(False)
    for head in (net.heads.boxes, net.heads.directions):
        head.requires_grad_(True)


def _train_step(run: _Run, step: int, crops: list[Crop], targets: list[Targets]) -> dict[str, float]:
    """One optimiser step; returns the parts of the loss and the learning rate."""
    recipe, device = run.recipe, run.compute.device
    if step >= recipe.steps:
        _settle(run.net)
    rate, momentum = one_cycle(step, recipe)
    for group in run.optimiser.param_groups:
        group["lr"], group["betas"] = rate, (momentum, 0.99)
    clouds, windows = [torch.from_numpy(crop.points).to(device) for crop in crops], [crop.window for crop in crops]
    with run.compute.autocast(recipe.bfloat16):
        outputs = run.net(clouds, windows)
    loss, parts = detection_loss(outputs.float(), [target.to(device) for target in targets], recipe.direction_weight)
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), recipe.clip_norm)
    run.optimiser.step()
    return {**parts, "learning_rate": rate}


def _batches(
    net: DetectorNet, recipe: Recipe, steps: range, mesh: Sequence[Path], inserted: Sequence[Path], ahead: int
) -> Iterator[Batch]:
    """Crops and targets of each step, the next ones made in threads while the network computes."""

    def prepare(step: int) -> Batch:
        crops = [_crop(net, recipe, step, slot, mesh, inserted) for slot in range(recipe.batch)]
        return step, crops, [_targets(net, crop, recipe.rim_cells) for crop in crops]

    with ThreadPoolExecutor(ahead) as worker:
        coming: deque[Future[Batch]] = deque(worker.submit(prepare, step) for step in steps[:ahead])
        for step in steps:
            batch = coming.popleft().result()
            if step + ahead in steps:
                coming.append(worker.submit(prepare, step + ahead))
            yield batch


def _crop(
    net: DetectorNet, recipe: Recipe, step: int, slot: int, mesh: Sequence[Path], inserted: Sequence[Path]
) -> Crop:
    rng = generator(f"{recipe.detector} crop", recipe.seed, step, slot)
    use_inserted = step >= recipe.mesh_only_steps and rng.random() < recipe.inserted_share
    files = inserted if use_inserted and len(inserted) else mesh
    return random_crop(
        load_cached(files[int(rng.integers(len(files)))]), net.grid, recipe.crop_cells, rng, recipe.jitter_m
    )


def _targets(net: DetectorNet, crop: Crop, rim_cells: int) -> Targets:
    anchors = anchor_boxes(WAYMO_ANCHORS, net.grid, crop.window)
    per_cell = len(WAYMO_ANCHORS.headings_rad)
    inner = torch.zeros(crop.window.num_y, crop.window.num_x, per_cell, dtype=torch.bool)
    inner[rim_cells : crop.window.num_y - rim_cells, rim_cells : crop.window.num_x - rim_cells] = True
    return assign_targets(anchors, torch.from_numpy(crop.boxes), torch.from_numpy(crop.usable), inner.reshape(-1))
