"""Placement of a task's vehicle in its scene, and the attack problem at that place."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.placement.sampling import NoPlacement, Placement, place
from shift3d.render.settings import STANDARD
from shift3d.scenes.facts import EffectSettings
from shift3d.seeding import derive_seed, generator
from shift3d.task.assets import Assets, render_settings, score_precision
from shift3d.task.places import constraints_of, limits_of, placement_context_of, scene_vehicle_centres
from shift3d.task.spec import TaskSpec

if TYPE_CHECKING:
    from shift3d.effects.chain import EffectChain
    from shift3d.vehicles.vehicle import Vehicle


def place_vehicle(spec: TaskSpec, assets: Assets) -> Placement | NoPlacement:
    """Place the vehicle: the same for every task of this vehicle, scene and placement settings.

    Independent of the task's mode, loss weights, accuracy and detector, and of the beams that see the street. Source:
    our choice: the paper is silent.
    """
    scene, beams, scene_hash = assets.placement_scene(spec)
    vehicle = assets.vehicle(spec)
    # Always at standard accuracy: rounding that rejects one draw would move the vehicle to another place, and
    # accuracies could not be compared object by object. Without an SDF grid, which takes longer than it saves.
    sdf = assets.decoder_of(STANDARD.dtype).field(torch.from_numpy(vehicle.latent_code).to(STANDARD.dtype))
    rng = generator("placement", replace(spec, scene_hash=scene_hash).placement_seed)
    limits, constraints = limits_of(spec.placement), constraints_of(spec.placement)
    return place(placement_context_of(scene, beams), sdf, vehicle, rng, limits, constraints)


def placed_pose(spec: TaskSpec, assets: Assets) -> Tensor | None:
    """Return (6,) float64 pose of `place_vehicle`, None if there is no place; computed once per worker and place."""
    _, _, scene_hash = assets.placement_scene(spec)
    assets.vehicle(spec)  # raises if the vehicle differs from the plan
    kept, key = assets.poses, (spec.vehicle, spec.scene, replace(spec, scene_hash=scene_hash).placement_seed)
    if key not in kept:
        placement = place_vehicle(spec, assets)
        kept[key] = None if isinstance(placement, NoPlacement) else placement.theta
    pose = kept[key]
    return None if pose is None else pose.clone()


def build_problem(spec: TaskSpec, assets: Assets, theta: Tensor, vehicle: Vehicle | None = None) -> AttackProblem:
    """Build the attack problem: the task's vehicle at ``theta`` (6,) and the detector at scoring precision.

    vehicle: another vehicle of the same decoder instead of the task's.
    Raises: InputError: a scene or vehicle that cannot be loaded.
    """
    scene, beams = assets.scene(spec)
    settings = render_settings(spec)
    space = assets.sdf_grid_of(spec, settings) if vehicle is None else None
    vehicle = vehicle or assets.vehicle(spec)
    return AttackProblem(
        beams=beams,
        ground_z_m=scene.ground_z_m,
        field_of=assets.decoder_of(settings.dtype).field,
        vehicle=vehicle,
        detector=assets.detector_of(spec.detector, score_precision(spec)),
        theta0=theta,
        code0=torch.from_numpy(vehicle.latent_code).to(settings.dtype),
        constraints=constraints_of(spec.placement),
        settings=settings,
        travel_m=spec.attack.max_shift_m,
        others=scene_vehicle_centres(scene),
        space=space,
        effects=_effects(spec, assets, vehicle),
        below_ground_m=spec.attack.below_ground_m,
    )


def with_other_vehicle(
    spec: TaskSpec, assets: Assets, problem: AttackProblem, vehicle: Vehicle | None
) -> AttackProblem:
    """Return the problem with another vehicle of the same decoder at the same place, on the same ground.

    Without another vehicle the problem itself is returned.
    """
    if vehicle is None:
        return problem
    theta = problem.theta0.clone()
    theta[2] += (vehicle.size_m[2] - problem.vehicle.size_m[2]) / 2
    return build_problem(spec, assets, theta, vehicle)


def _effects(spec: TaskSpec, assets: Assets, vehicle: Vehicle) -> EffectChain | None:
    """Build the task's effects; without effects none of their code is imported.

    Their random numbers depend on the placement alone: shape and pose attacks of one placement have one baseline.
    """
    if not spec.effects:
        return None
    from shift3d.effects.chain import EffectChain

    scene, settings = assets.scene(spec)[0], EffectSettings(**spec.effect_settings)
    # A moving vehicle moves along its heading at placement, even if an attack changes its pose.
    pose = placed_pose(spec, assets) if settings.object_speed_m_s else None
    heading_rad = 0.0 if pose is None else float(pose[3])
    seed = derive_seed("effects", spec.placement_seed)
    return EffectChain.of(spec.effects, scene, vehicle, seed, settings, heading_rad)
