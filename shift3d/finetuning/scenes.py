"""Training scenes of a sweep: each object in the scene that it was found in, and the scenes without one."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from tqdm import tqdm

from shift3d.attack.objective import object_box
from shift3d.finetuning.objects import SweepObject, SweepObjects
from shift3d.task.assets import Assets
from shift3d.task.rendered import render_solution
from shift3d.task.spec import TaskSpec
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, cut_scene, from_scene

__all__ = ["natural_scenes", "object_scene", "object_scenes", "objects_digest"]


def objects_digest(found: SweepObjects) -> str:
    """64 bits of which objects they are, hex."""
    text = "\n".join(f"{task} {method} {replicate}" for task, method, replicate in (row.key for row in found.objects))
    return hashlib.blake2b(f"{found.plan.spec_hash}\n{text}".encode(), digest_size=8).hexdigest()


def object_scenes(folder: Path, found: SweepObjects) -> list[Path]:
    """Cached scenes with one object each, in the order of the objects; those that are missing are rendered.

    Raises: InputError for a scene, vehicle or weights that are not those of the sweep.
    """
    rows = {"-".join(map(str, row.key)): row for row in found.objects}
    names = tqdm(list(rows), desc="objects in their scenes", mininterval=5.0)
    place = folder / f"objects-{objects_digest(found)}"
    return cache_scenes(place, names, lambda name: object_scene(rows[name], found.assets_of(rows[name])))


def natural_scenes(folder: Path, found: SweepObjects) -> list[Path]:
    """Cached scenes of the same sweep as they are, each once."""
    rows = {row.spec.scene: row for row in found.objects}
    names = tqdm(list(rows), desc="the same scenes without", mininterval=5.0)

    def build(name: str) -> TrainingScene:
        row = rows[name]
        return from_scene(found.assets_of(row).scene(row.spec)[0], _sector_rad(row.spec))

    return cache_scenes(folder / f"scenes-{objects_digest(found)}", names, build)


def object_scene(row: SweepObject, assets: Assets) -> TrainingScene:
    """An object rendered into its scene as its task did, its box labelled and last; cut to what is labelled.

    The box has the size of the unchanged vehicle, as where the object is attacked and scored. Points that effects made
    vanish are left out.
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
    return cut_scene(on_ground, boxes, -float(scene.ground_z_m), _sector_rad(row.spec))


def _sector_rad(spec: TaskSpec) -> tuple[float, float]:
    return spec.placement.sector_centre_rad, spec.placement.sector_half_width_rad
