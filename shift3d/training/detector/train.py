"""Training of a detector from scenes to weights: make the scenes, insert vehicles, train, export."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.weights import wrong_values
from shift3d.errors import InputError
from shift3d.scenes.sets import SceneSet, StreetScenes
from shift3d.scenes.street.build.fleet import fleet_of
from shift3d.scenes.street.options import StreetOptions
from shift3d.seeding import generator
from shift3d.store.arrays import write_safetensors
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.compute import ONE_THREAD, Compute, restore_subnormals
from shift3d.training.detector.loop import CHECKPOINT, SHIPPED_DATA, own_checkpoint, train_on_scenes
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector.warm_start import start_file, start_state
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, from_scene, load_cached
from shift3d.training.inserted_vehicles import with_inserted_vehicles
from shift3d.training.progress import Report, curve_facts
from shift3d.training.provenance import read_provenance, write_provenance
from shift3d.vehicles.family.split import SPLIT

TRAFFIC = "wide"  # family of the vehicles in training streets and insertions, seen kinds only


@restore_subnormals()
def train_detector(
    out_dir: Path,
    recipe: Recipe,
    weights_file: Path | None = None,
    scenes: SceneSet | None = None,
    start_from: Path | None = None,
    compute: Compute = ONE_THREAD,
    report: Report | None = None,
) -> None:
    """Run the whole recipe: make scenes, train on them, then on those with inserted vehicles too, export.

    Args:
        out_dir: folder of scenes, checkpoint and weights; an interrupted training resumes from it.
        weights_file: safetensors file, with provenance as JSON beside it (default out_dir/<detector>.safetensors).
        scenes: labelled scenes to train on, default the shipped recipe's procedural streets. Only the labelled sector
            of each is used, see :func:`~shift3d.training.detector_scenes.from_scene`.
        start_from: weights to start from instead of random weights or of the recipe's own start.
        compute: default the CPU, one thread; another number of threads changes the weights by rounding.
        report: see :func:`train_on_scenes`.
    Raises: InputError when the recipe is invalid, weights to start from are missing, the scenes hold no vehicle, the
    checkpoint is of another recipe, other scenes or another start, or the training diverges: then weights_file stays as
    it was; KeyboardInterrupt on SIGINT or SIGTERM.
    """
    recipe.validate()
    begun_with = start_file(recipe, start_from)
    data = _identity(scenes, begun_with)
    own_checkpoint(out_dir / CHECKPOINT, recipe, data)  # a folder of another training is refused before scenes are made
    start = start_state(recipe, start_from)
    before = None if begun_with is None else read_provenance(begun_with)
    compute.prepare()
    workers = compute.scene_workers
    if scenes is None:
        base = mesh_scene_files(out_dir, recipe.mesh_scenes, workers)
    else:
        base = scene_files(out_dir, scenes, workers)
    shared: dict[str, Any] = {"compute": compute, "report": report, "data": data, "start": start}
    train_on_scenes(out_dir, recipe, base, stop_after=recipe.mesh_only_steps, **shared)
    inserted: list[Path] = []
    if recipe.inserted_scenes and recipe.inserted_share > 0.0:
        inserted = inserted_scene_files(out_dir, base, recipe, workers)
    net = train_on_scenes(out_dir, recipe, base, inserted, **shared)
    weights_file = weights_file or out_dir / f"{recipe.detector}.safetensors"
    export_weights(net, weights_file, recipe)
    started = {"started_from": None if begun_with is None else begun_with.name, "before": before}
    write_provenance(weights_file, started | _recipe_facts(recipe, scenes) | training_facts(out_dir, recipe, compute))


def _identity(scenes: SceneSet | None, start_from: Path | None) -> str:
    """Return the text that identifies scenes and start weights in a checkpoint."""
    parts = [f"{SHIPPED_DATA}-{TRAFFIC}" if scenes is None else f"{scenes.dataset}-{_digest(scenes)}"]
    if start_from is not None and start_from.is_file():
        parts.append(hashlib.blake2b(start_from.read_bytes(), digest_size=8).hexdigest())
    return " from ".join(parts)


def _digest(scenes: SceneSet) -> str:
    """Return a 64-bit hex digest that changes with the scenes and with the state of their files."""
    text = json.dumps([scenes.dataset, [scenes.source(name) for name in scenes.names()]])
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _recipe_facts(recipe: Recipe, scenes: SceneSet | None) -> dict[str, Any]:
    """Return the scenes and vehicles of a training, for its provenance."""
    names = [] if scenes is None else scenes.names()
    street = {"dataset": f"street-mixed-{TRAFFIC}", "split": "train", "count": recipe.mesh_scenes}
    return {
        "scenes": street if scenes is None else {"dataset": scenes.dataset, "count": len(names), "names": names},
        "vehicles": {"made_by": "meshes of the wide family, none by the decoder", **SPLIT.to_dict()},
    }


def training_facts(out_dir: Path, recipe: Recipe, compute: Compute) -> dict[str, Any]:
    """Return the provenance of any training from its last checkpoint: recipe, steps, machine, time and curve."""
    state = read_checkpoint(out_dir / CHECKPOINT)
    return {
        "model": recipe.detector,
        "recipe": asdict(recipe),
        "steps": state["steps_done"],
        "compute": compute.facts(recipe.bfloat16) | {"steps_by_device": dict(state.get("steps_by_device", {}))},
        "training_seconds": round(float(state.get("seconds", 0.0)), 1),
        "curve": curve_facts(state.get("curve", [])),
    }


def export_weights(net: DetectorNet, file: Path, recipe: Recipe, halved: bool = True) -> None:
    """Write the weights atomically as safetensors, with the recipe in the metadata.

    halved: store matrices and kernels in float16, to 2^-11 of each value (our choice: half the bytes). Biases and batch
    statistics stay float32: variances exceed the range of float16.

    Raises: InputError if `load_weights` would refuse the weights, or the disk is full; the file stays as it was.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    if halved:
        large = {name for name, tensor in tensors.items() if tensor.is_floating_point() and tensor.dim() >= 2}
        tensors |= {name: tensors[name].half() for name in large}
    for name, tensor in tensors.items():
        if wrong := wrong_values(name, tensor, tensor):
            raise InputError(f"tensor {name} {wrong}", str(file), "Train with a smaller recipe.peak_rate=")
    write_safetensors(file, tensors, {"recipe": repr(recipe)})


def mesh_scene_files(out_dir: Path, count: int, workers: int = 1) -> list[Path]:
    """Return cached procedural scenes of both sensors, split train, with vehicles of the wide family's seen kinds."""
    scenes = StreetScenes("mixed", count=count, split="train", options=StreetOptions(traffic=TRAFFIC))
    build = partial(_labelled_scene, scenes)
    return cache_scenes(out_dir / f"{TRAFFIC}-train", scenes.names(), build, "street scenes", workers)


def _labelled_scene(scenes: SceneSet, name: str) -> TrainingScene:
    return from_scene(scenes.load(name), scenes.placement_sector_rad)


def scene_files(out_dir: Path, scenes: SceneSet, workers: int = 1) -> list[Path]:
    """Return cached scenes of any set, cut to their labelled sector, in the order of its names.

    Raises: InputError for a frame that cannot be read, or when no scene holds a vehicle.
    """
    folder = out_dir / f"scenes-{_digest(scenes)}"
    title = f"{scenes.dataset} scenes"
    files = cache_scenes(folder, scenes.names(), partial(_labelled_scene, scenes), title, workers)
    if not any(len(load_cached(file).boxes) for file in files):
        raise InputError("no scene has a labelled vehicle", where=title, remedy="Give labelled scenes")
    return files


def inserted_scene_files(out_dir: Path, base: Sequence[Path], recipe: Recipe, workers: int = 1) -> list[Path]:
    """Return cached scenes: the base scenes in turn, with inserted vehicles of the wide family's seen kinds."""
    # Insertions depend on the seed and on the base scenes; the name keeps scene sets in one out_dir apart.
    folder = out_dir / f"inserted-{base[0].parent.name}-{len(base)}-{recipe.seed}"
    names = [f"inserted-{index:05d}" for index in range(recipe.inserted_scenes)]
    build = partial(_inserted_scene, tuple(base), recipe.seed)
    return cache_scenes(folder, names, build, "inserting vehicles", workers)


def _inserted_scene(base: Sequence[Path], seed: int, name: str) -> TrainingScene:
    rng = generator("inserted scene", seed, name)
    scene = load_cached(base[int(name.rsplit("-", 1)[1]) % len(base)])
    return with_inserted_vehicles(scene, fleet_of(TRAFFIC, "train"), rng)
