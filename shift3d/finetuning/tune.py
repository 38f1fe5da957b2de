"""Fine-tuning of a detector on the objects of a sweep, and its weights with provenance.

Source: SHIFT3D, Improving Model Robustness: one epoch at a small rate over scenes with an object. Our choice beyond it:
half of the crops show the same scenes without an object, the box loss weighs less relative to the class loss, and batch
norms keep the statistics of the start, so that a rate of 0 leaves the detector unchanged.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from shift3d.attack.objective import object_box
from shift3d.detectors.models.weights import ANCHOR_SIZE, load_network
from shift3d.errors import InputError
from shift3d.finetuning.objects import SweepObject, SweepObjects, stable_objects
from shift3d.settings.catalogue.detector_files import file_hash
from shift3d.store.resolve import LocationLike
from shift3d.task.assets import Assets
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.spec import TaskSpec
from shift3d.training.command import WEIGHTS_FOLDER, TrainOptions
from shift3d.training.compute import restore_subnormals
from shift3d.training.detector.crop_sampling import EpochCrops, epoch_steps
from shift3d.training.detector.loop import CHECKPOINT, own_checkpoint, train_on_scenes
from shift3d.training.detector.recipe import Augmentation, Recipe
from shift3d.training.detector.recipes import RECIPES, changed
from shift3d.training.detector.train import export_weights, training_facts
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, cut_scene, from_scene
from shift3d.training.progress import Report
from shift3d.training.provenance import read_provenance, write_provenance


def objects_digest(found: SweepObjects) -> str:
    """Return a 64-bit hex digest of the objects: their tasks, codes and poses."""
    solutions = [json.dumps([row.key, row.solution], sort_keys=True) for row in found.objects]
    text = "\n".join([found.plan.spec_hash, *solutions])
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def object_scenes(folder: Path, found: SweepObjects) -> list[Path]:
    """Return cached scenes with one object each, in the order of the objects; missing scenes are rendered.

    Raises: InputError for a scene, vehicle or weights that differ from those of the sweep.
    """
    rows = {"-".join(map(str, row.key)): row for row in found.objects}
    place = folder / f"objects-{objects_digest(found)}"

    def build(name: str) -> TrainingScene:
        return object_scene(rows[name], found.assets_of(rows[name]))

    return cache_scenes(place, rows, build, "scenes with objects")


def natural_scenes(folder: Path, found: SweepObjects) -> list[Path]:
    """Return cached scenes of the same sweep without objects, each once."""
    rows = found.by_scene

    def build(name: str) -> TrainingScene:
        row = rows[name]
        return from_scene(found.assets_of(row).scene(row.spec)[0], _sector_rad(row.spec))

    return cache_scenes(folder / f"scenes-{objects_digest(found)}", rows, build, "scenes without objects")


def object_scene(row: SweepObject, assets: Assets) -> TrainingScene:
    """Render an object into its scene as its task did, label its box last, and cut the scene to its labelled sector.

    The box has the size of the unchanged vehicle, as in attack and scoring. Points that effects removed are left out.
    """
    scene, _ = assets.scene(row.spec)
    rendered = render_solution(row.spec, row.solution, assets)
    points, returned = rendered.rendering.points, rendered.rendering.returned
    kept = np.ones(len(points), dtype=bool) if returned is None else returned.numpy().copy()
    kept[: len(scene.points)] &= scene.has_beam
    own = object_box(rendered.theta, rendered.problem.vehicle.size_m, scene.ground_z_m)
    boxes = scene.labels.of_class("vehicle").reshape(-1, 7).astype(np.float32)
    boxes[:, 2] -= np.float32(scene.ground_z_m)
    on_ground = points.numpy()[kept].astype(np.float32) - np.array((0.0, 0.0, scene.ground_z_m), dtype=np.float32)
    boxes = np.concatenate((boxes, own[None].astype(np.float32)))
    # A pose search may have moved the object out of the sector of its placement.
    return cut_scene(on_ground, boxes, -float(scene.ground_z_m), _sector_rad(row.spec), keep_last_box=True)


def _sector_rad(spec: TaskSpec) -> tuple[float, float]:
    return spec.placement.sector_centre_rad, spec.placement.sector_half_width_rad


RATE = 1e-5
"""Peak learning rate (our choice, for an epoch of some hundred steps; the paper: 1e-7, its optimiser unstated)."""
BOX_WEIGHT_FACTOR = 0.1
"""Factor on the recipe's weights of boxes and directions (our choice).

In a crop about a hard object their gradient is thirty times that of the class: at full weight the object's score fell
over 36 steps at `RATE`, at a tenth it rose.
"""

BATCH = 2  # crops per step, for which `RATE` was chosen


@restore_subnormals()
def fine_tune(
    detector: str, sweep: LocationLike, options: TrainOptions, method: str = "adversarial", report: Report | None = None
) -> Path:
    """Train one epoch over the stable objects of a verified sweep, or resume an interrupted training.

    Args:
        options: uses out, threads, device, steps (None: an epoch's), start_from (None: shipped weights) and recipe.
        method: of the objects: "adversarial", or "baseline" for a control that sees the same scenes.
        report: called with the curves' points after every checkpoint.
    Returns: the weights file, float32, with a JSON file of provenance beside it: the same bytes for the same sweep,
    recipe and start on one processor.
    Raises: InputError: as `stable_objects`; a field that a recipe does not have; a checkpoint of another tuning in out.
    """
    shipped = WEIGHTS_FOLDER / f"{detector}.safetensors"
    start = shipped if options.start_from in (None, "shipped") else Path(str(options.start_from)).expanduser()
    if not start.is_file():
        raise InputError("no such weights file", where=str(start), remedy="Give start_from=FILE, or start_from=shipped")
    start_hash, before = file_hash(start), read_provenance(start)
    found = stable_objects(sweep, detector, start_hash, method)
    state = load_network(start, detector).state_dict()
    recipe = _with_anchors(tuning_recipe(detector, len(found.objects), options), state)
    compute = options.compute()
    compute.prepare()
    data = f"objects-{objects_digest(found)} from {start_hash}"
    own_checkpoint(options.out / CHECKPOINT, recipe, data)  # before scenes are made
    natural, inserted = natural_scenes(options.out, found), object_scenes(options.out, found)
    net = train_on_scenes(
        options.out,
        recipe,
        natural,
        inserted,
        compute=compute,
        report=report,
        data=data,
        start=state,
        draw=EpochCrops,
        keep_statistics=True,
    )
    weights = options.out / f"{detector}.safetensors"
    # In float16 a small rate's changes would be rounded away.
    export_weights(net, weights, recipe, halved=False)
    facts = training_facts(options.out, recipe, compute) | {
        "rate": recipe.peak_rate,
        "seed": recipe.seed,
        "started_from": {"file": start.name, "blake2b": start_hash},
        "before": before,
        "finetuned_on": _tuned_on(found, method),
    }
    write_provenance(weights, facts)
    return weights


# The sweep, the start, steps= or `EpochCrops` decide these.
_FIXED_FIELDS = ("steps", "anchor_size_m", "mesh_scenes", "inserted_scenes", "mesh_only_steps")


def tuning_recipe(detector: str, objects: int, options: TrainOptions) -> Recipe:
    """Return the detector's recipe for one epoch over some objects at `RATE`, with the given fields.

    Crops use the default augmentation: the detector's own may widen sizes and so change the found shapes.
    Raises: InputError for an unknown field, or a value that it cannot have.
    """
    shipped = RECIPES[detector]
    recipe = replace(
        shipped,
        batch=BATCH,
        augmentation=Augmentation(),
        seed=0,
        warm_up_share=0.3,
        peak_rate=RATE,
        box_weight=BOX_WEIGHT_FACTOR * shipped.box_weight,
        direction_weight=BOX_WEIGHT_FACTOR * shipped.direction_weight,
        grown_from="",
        backbone_from="",
        mesh_only_steps=0,
        settle_steps=0,
        statistics_crops=0,
    )
    for name in _FIXED_FIELDS:
        if name in options.recipe:
            remedy = "Give steps=N" if name == "steps" else f"Leave recipe.{name}= out"
            raise InputError(f"recipe.{name}= means nothing with finetune=", "train", remedy)
    if options.steps == 0:
        raise InputError("steps=0 tunes nothing", "train", "Give steps=N from 1, or leave steps= out for one epoch")
    recipe = changed(recipe, options.recipe)
    if recipe.inserted_share <= 0.0:
        raise InputError("recipe.inserted_share=0 leaves no object", "train", "Give a share above 0")
    return replace(recipe, steps=options.steps or epoch_steps(objects, recipe))


def _with_anchors(recipe: Recipe, state: Mapping[str, Tensor]) -> Recipe:
    """Return the recipe with the anchors of the start weights, which stay as they are."""
    if ANCHOR_SIZE not in state:
        return recipe
    length, width, height = state[ANCHOR_SIZE].tolist()
    return replace(recipe, anchor_size_m=(length, width, height))


def _tuned_on(found: SweepObjects, method: str) -> dict[str, Any]:
    """Return the facts about the objects of a fine-tuning, for its provenance."""
    vehicles = Counter(row.spec.vehicle for row in found.objects)
    return {
        "sweep": found.plan.sweep,
        "spec_hash": found.plan.spec_hash,
        "method": method,
        "objects": len(found.objects),
        "left_out": found.left_out,
        "vehicles": dict(sorted(vehicles.items())),
        "scenes": found.scenes,
        "rows": [[task, replicate] for task, _, replicate in (row.key for row in found.objects)],
    }
