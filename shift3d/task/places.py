"""Possible places of vehicles in scenes, for the placement settings of tasks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import PlacementContext, PlacementLimits
from shift3d.placement.survey import Survey, survey
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import SceneSet, StreetScenes
from shift3d.task.spec import PlacementSpec


def limits_of(where: PlacementSpec) -> PlacementLimits:
    """Return the limits within which places are drawn."""
    sector = (where.sector_centre_rad, where.sector_half_width_rad)
    return PlacementLimits(where.min_range_m, where.max_range_m, sector, where.attempts)


def constraints_of(where: PlacementSpec) -> Constraints:
    """Return the constraints that a place must satisfy."""
    return Constraints(where.overlap_m, where.contact_m, where.min_object_points)


def scene_vehicle_centres(scene: Scene) -> Tensor:
    """Return (M, 2) centres of the scene's vehicles; a box of one near the object would pass for a detection of it."""
    return torch.from_numpy(scene.labels.of_class("vehicle").reshape(-1, 7)[:, :2].copy())


def placement_context_of(scene: Scene, beams: Beams) -> PlacementContext:
    """Return the facts about a scene, seen by these beams, that decide about places."""
    zone = scene.in_no_label_zone
    unlabelled = None if zone is None else scene.points[zone & scene.has_beam, :2]
    return PlacementContext(beams, scene.ground_z_m, scene_vehicle_centres(scene), scene.ground_map, unlabelled)


def survey_scene(scenes: SceneSet, name: str, where: PlacementSpec) -> Survey:
    """Survey a scene for places of a car of usual size, like `place_vehicle`: a street by its own sensor's beams.

    Raises: InputError: the scene cannot be read.
    """
    own = scenes.with_own_sensor(name) if isinstance(scenes, StreetScenes) else None
    scene = scenes.load(name) if own is None else own[0].load(own[1])
    return survey(placement_context_of(scene, Beams.of_main_sensor(scene)), limits_of(where), constraints_of(where))


NO_GROUND = (
    "where no ground is seen, lower attack.placement.max_range_m: scan lines lie closer there; see that shift3d scenes "
    "show prints the right height of the ground (scenes.ground_z_m changes it for openpcdet), and that z points up"
)
"""Remedy if `Survey.lacks_ground`."""


def place_lines(scenes: SceneSet, names: Sequence[str], where: PlacementSpec, most: int = 20) -> Iterator[str]:
    """Yield a line for each of the first `most` scenes: free places and the reasons against others; then `NO_GROUND`.

    Raises: InputError: a scene cannot be read.
    """
    lacks_ground = False
    for name in names[:most]:
        found = survey_scene(scenes, name, where)
        lacks_ground |= found.lacks_ground
        yield f"  {name}: {found.line()}"
    if len(names) > most:
        yield f"  and {len(names) - most} more"
    if lacks_ground:
        yield f"  {NO_GROUND}"
