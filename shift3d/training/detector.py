"""Training of a detector on crops of scenes: a fixed number of steps, resumable to the same weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import cos, pi
from pathlib import Path

import torch
from safetensors.torch import save_file
from tqdm import tqdm

from shift3d.detectors.anchors import WAYMO_ANCHORS, anchor_boxes
from shift3d.detectors.backbone import WAYMO_BACKBONE, BackboneSpec
from shift3d.detectors.network import AnchorNet
from shift3d.detectors.pointpillars import PointPillarsNet
from shift3d.detectors.sst import SST_SPEC, SstNet, SstSpec
from shift3d.errors import InputError
from shift3d.scenes.sets import StreetScenes
from shift3d.sdf.decoder import load_decoder
from shift3d.seeding import generator
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.detector_augmentation import Crop, random_crop
from shift3d.training.detector_losses import detection_loss
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, from_scene, load_cached
from shift3d.training.detector_targets import Targets, assign_targets
from shift3d.training.inserted_vehicles import insertable_vehicles, with_inserted_vehicles

__all__ = ["RECIPES", "Recipe", "export_weights", "one_cycle", "train_detector", "train_on_scenes"]


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the trained weights, beside the scenes. Threads are not part of it.

    network: sizes of the detector, which say what it is. steps: optimiser steps; the first `mesh_only_steps`
    use mesh scenes alone, after which each crop comes from a scene with rendered insertions with probability
    `inserted_share`. crop_cells: side of the square crops; batch: crops a step; rim_cells: anchors so close to
    a crop's edge are not trained; jitter_m: how far a crop's centre lies from the vehicle it was chosen for.
    bfloat16: take large products in half the bytes, which pays where the processor has instructions for it.
    """

    network: BackboneSpec | SstSpec = WAYMO_BACKBONE
    steps: int = 7000
    mesh_only_steps: int = 2700
    inserted_share: float = 0.5
    mesh_scenes: int = 400
    inserted_scenes: int = 240
    inserted_vehicles: int = 99
    crop_cells: int = 112
    batch: int = 2
    rim_cells: int = 6
    jitter_m: float = 11.0
    peak_rate: float = 1.5e-3
    weight_decay: float = 0.01
    warm_up_share: float = 0.3
    clip_norm: float = 10.0
    direction_weight: float = 0.2
    bfloat16: bool = True
    seed: int = 0

    @property
    def detector(self) -> str:
        """Name of the detector that these sizes belong to."""
        return "sst" if isinstance(self.network, SstSpec) else "pointpillars"

    def new_network(self) -> AnchorNet:
        """An untrained network, from torch's global random state."""
        return SstNet(self.network) if isinstance(self.network, SstSpec) else PointPillarsNet(self.network)


RECIPES: dict[str, Recipe] = {
    "pointpillars": Recipe(),
    # Attention costs by the token and the dense layers by the cell, so that small crops around vehicles teach
    # most for the time; weight decay is the published one, the peak rate fits batches of two (our choice).
    "sst": Recipe(
        network=SST_SPEC,
        steps=5000,
        mesh_only_steps=1250,
        crop_cells=64,
        jitter_m=6.0,
        peak_rate=6e-4,
        weight_decay=0.05,
        warm_up_share=0.15,
        direction_weight=1.0,
        bfloat16=False,
    ),
}


def one_cycle(step: int, recipe: Recipe) -> tuple[float, float]:
    """(learning rate, first momentum) of a step: cosine up and down again.

    Source: one-cycle as in SECOND's public code (rate from a tenth of the peak, momentum 0.95 to 0.85).
    """
    rise = max(1.0, recipe.warm_up_share * recipe.steps)
    if step < rise:
        part = 0.5 - 0.5 * cos(pi * step / rise)
        return recipe.peak_rate * (0.1 + 0.9 * part), 0.95 - 0.10 * part
    part = 0.5 + 0.5 * cos(pi * min(1.0, (step - rise) / max(1.0, recipe.steps - rise)))
    return recipe.peak_rate * max(part, 1e-4), 0.95 - 0.10 * part


def train_on_scenes(
    out_dir: Path,
    recipe: Recipe,
    mesh_scenes: Sequence[Path],
    inserted_scenes: Sequence[Path] = (),
    threads: int = 1,
    checkpoint_every: int = 250,
    stop_after: int | None = None,
) -> AnchorNet:
    """Train, or go on from out_dir's checkpoint, to recipe.steps (or stop_after, to be resumed).

    A resumed training gives the weights of an uninterrupted one: the crops of a step depend on the seed and
    the step alone. Every `checkpoint_every` steps a checkpoint replaces the last one.

    Raises: InputError if the checkpoint belongs to another recipe.
    """
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)  # subnormal weights, which a network may have many of, cost several times the time
    torch.manual_seed(recipe.seed)
    net = recipe.new_network()
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(net.parameters(), lr=recipe.peak_rate, weight_decay=recipe.weight_decay)
    out_dir.mkdir(parents=True, exist_ok=True)
    done = _resume(out_dir / "checkpoint.pt", recipe, net, optimiser)
    net.train()
    end = recipe.steps if stop_after is None else min(recipe.steps, stop_after)
    smoothed: dict[str, float] = {}
    batches = _batches(net, recipe, range(done, end), mesh_scenes, inserted_scenes)
    progress = tqdm(batches, initial=done, total=recipe.steps, desc=recipe.detector, mininterval=5.0)
    for step, crops, targets in progress:
        parts = _train_step(net, optimiser, recipe, step, crops, targets)
        for name, value in parts.items():
            smoothed[name] = value if name not in smoothed else 0.98 * smoothed[name] + 0.02 * value
        if (step + 1) % checkpoint_every == 0 or step + 1 == end:
            _save(out_dir / "checkpoint.pt", recipe, net, optimiser, step + 1)
            report = "  ".join(f"{name} {value:.3f}" for name, value in smoothed.items())
            tqdm.write(f"step {step + 1}  {report}")
    net.eval()
    return net


def _train_step(
    net: AnchorNet,
    optimiser: torch.optim.Optimizer,
    recipe: Recipe,
    step: int,
    crops: list[Crop],
    targets: list[Targets],
) -> dict[str, float]:
    rate, momentum = one_cycle(step, recipe)
    for group in optimiser.param_groups:
        group["lr"], group["betas"] = rate, (momentum, 0.99)
    clouds, windows = [torch.from_numpy(crop.points) for crop in crops], [crop.window for crop in crops]
    with torch.autocast("cpu", torch.bfloat16, enabled=recipe.bfloat16):
        outputs = net(clouds, windows)
    outputs = type(outputs)(outputs.logits.float(), outputs.codes.float(), outputs.directions.float())
    loss, parts = detection_loss(outputs, targets, recipe.direction_weight)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), recipe.clip_norm)
    optimiser.step()
    return parts


def _batches(
    net: AnchorNet, recipe: Recipe, steps: range, mesh: Sequence[Path], inserted: Sequence[Path]
) -> Iterator[tuple[int, list[Crop], list[Targets]]]:
    """Crops and targets of each step, the next ones made in a thread while the network computes."""

    def prepare(step: int) -> tuple[int, list[Crop], list[Targets]]:
        crops = [_crop(net, recipe, step, slot, mesh, inserted) for slot in range(recipe.batch)]
        return step, crops, [_targets(net, crop, recipe.rim_cells) for crop in crops]

    with ThreadPoolExecutor(1) as worker:
        coming = [worker.submit(prepare, step) for step in steps[:1]]
        for step in steps:
            batch = coming.pop().result()
            if step + 1 in steps:
                coming.append(worker.submit(prepare, step + 1))
            yield batch


def _crop(net: AnchorNet, recipe: Recipe, step: int, slot: int, mesh: Sequence[Path], inserted: Sequence[Path]) -> Crop:
    rng = generator(f"{recipe.detector} crop", recipe.seed, step, slot)
    use_inserted = step >= recipe.mesh_only_steps and rng.random() < recipe.inserted_share
    files = inserted if use_inserted and len(inserted) else mesh
    return random_crop(
        load_cached(files[int(rng.integers(len(files)))]), net.grid, recipe.crop_cells, rng, recipe.jitter_m
    )


def _targets(net: AnchorNet, crop: Crop, rim_cells: int) -> Targets:
    anchors = anchor_boxes(WAYMO_ANCHORS, net.grid, crop.window)
    per_cell = len(WAYMO_ANCHORS.headings_rad)
    inner = torch.zeros(crop.window.num_y, crop.window.num_x, per_cell, dtype=torch.bool)
    inner[rim_cells : crop.window.num_y - rim_cells, rim_cells : crop.window.num_x - rim_cells] = True
    return assign_targets(anchors, torch.from_numpy(crop.boxes), torch.from_numpy(crop.usable), inner.reshape(-1))


def _save(file: Path, recipe: Recipe, net: AnchorNet, optimiser: torch.optim.Optimizer, steps_done: int) -> None:
    state = {
        "steps_done": steps_done,
        "recipe": repr(recipe),
        "net": net.state_dict(),
        "optimiser": optimiser.state_dict(),
    }
    write_checkpoint(file, state)


def _resume(file: Path, recipe: Recipe, net: AnchorNet, optimiser: torch.optim.Optimizer) -> int:
    state = read_checkpoint(file)
    if state is None:
        return 0
    if state.get("recipe") != repr(recipe):
        raise InputError(
            "the checkpoint was trained by another recipe", where=str(file), remedy="choose another folder"
        )
    net.load_state_dict(state["net"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["steps_done"])


def export_weights(net: AnchorNet, file: Path, recipe: Recipe) -> None:
    """Write the weights as safetensors, with the recipe in the metadata, replacing the file in one step."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(file.name + ".partial")
    tensors = {name: tensor.contiguous() for name, tensor in net.state_dict().items()}
    save_file(tensors, partial, metadata={"model": recipe.detector, "recipe": repr(recipe)})
    partial.replace(file)


def train_detector(
    out_dir: Path,
    recipe: Recipe,
    threads: int = 1,
    weights_file: Path | None = None,
    vehicles_file: Path | None = None,
    decoder_file: Path | None = None,
) -> AnchorNet:
    """The whole recipe: make scenes, train on mesh vehicles, then on inserted ones too, export.

    out_dir: scenes, checkpoint and weights; an interrupted training goes on from there. weights_file: where
    the safetensors go (default out_dir/<detector>.safetensors). threads: may change from call to call; the
    weights then agree to rounding, not to the bit. vehicles_file, decoder_file: default the shipped ones.

    Raises: InputError when the shape decoder's weights are missing or the checkpoint is of another recipe.
    """
    mesh = mesh_scene_files(out_dir, recipe.mesh_scenes)
    train_on_scenes(out_dir, recipe, mesh, threads=threads, stop_after=recipe.mesh_only_steps)
    torch.set_num_threads(threads)
    inserted = inserted_scene_files(out_dir, mesh, recipe, vehicles_file, decoder_file)
    net = train_on_scenes(out_dir, recipe, mesh, inserted, threads=threads)
    export_weights(net, weights_file or out_dir / f"{recipe.detector}.safetensors", recipe)
    return net


def mesh_scene_files(out_dir: Path, count: int) -> list[Path]:
    """Cached procedural scenes of both sensors, split train."""
    scenes = StreetScenes("mixed", count=count, split="train")
    names = tqdm(scenes.names(), desc="street scenes", mininterval=5.0)
    return cache_scenes(out_dir / "mesh-train", names, lambda name: from_scene(scenes.load(name)))


def inserted_scene_files(
    out_dir: Path, mesh: Sequence[Path], recipe: Recipe, vehicles_file: Path | None, decoder_file: Path | None
) -> list[Path]:
    """Cached scenes with vehicles that our renderer inserted into mesh scenes, in their order.

    Raises: InputError when the shape decoder's weights are missing.
    """
    folder = out_dir / "inserted-train"
    names = [f"inserted-{index:05d}" for index in range(recipe.inserted_scenes)]
    if all((folder / f"{name}.npz").exists() for name in names):
        return [folder / f"{name}.npz" for name in names]
    decoder = load_decoder(decoder_file)
    vehicles = insertable_vehicles(recipe.inserted_vehicles, recipe.seed, decoder, vehicles_file)

    def build(name: str) -> TrainingScene:
        rng = generator("inserted scene", recipe.seed, name)
        scene = load_cached(mesh[int(name.rsplit("-", 1)[1]) % len(mesh)])
        return with_inserted_vehicles(scene, vehicles, decoder, rng)

    return cache_scenes(folder, tqdm(names, desc="inserting vehicles", mininterval=5.0), build)
