"""Where vehicles could stand in scenes, by the placement settings of tasks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import PlacementLimits
from shift3d.placement.survey import Survey, survey
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import SceneSet
from shift3d.task.spec import PlacementSpec


def limits_of(where: PlacementSpec) -> PlacementLimits:
    """Where places are drawn."""
    sector = (where.sector_centre_rad, where.sector_half_width_rad)
    return PlacementLimits(where.min_range_m, where.max_range_m, sector, where.attempts)


def constraints_of(where: PlacementSpec) -> Constraints:
    """What a place must satisfy."""
    return Constraints(where.overlap_m, where.contact_m, where.min_object_points)


def other_vehicles(scene: Scene) -> Tensor:
    """(M, 2) centres of the scene's own vehicles: a box of theirs near the object would pass for a detection of it."""
    return torch.from_numpy(scene.labels.of_class("vehicle").reshape(-1, 7)[:, :2].copy())


def survey_scene(scene: Scene, where: PlacementSpec) -> Survey:
    """Where a car of usual size could stand in a scene."""
    beams, others = Beams.of_main_sensor(scene), other_vehicles(scene)
    return survey(beams, scene.ground_z_m, limits_of(where), constraints_of(where), others, scene.ground_map)


def place_lines(scenes: SceneSet, names: Sequence[str], where: PlacementSpec, most: int = 20) -> Iterator[str]:
    """A line a scene, of the first so many: how many places are free, and what refuses the others.

    Raises: InputError: a scene cannot be read.
    """
    for name in names[:most]:
        yield f"  {name}: {survey_scene(scenes.load(name), where).line()}"
    if len(names) > most:
        yield f"  and {len(names) - most} more"
