"""One task: place the vehicle, attack it, score what was found and what it is compared with."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from shift3d.attack.baselines import noise_codes, random_code, random_pose
from shift3d.attack.constraints import Constraints
from shift3d.attack.placement import NoPlacement, Placement, PlacementLimits, place
from shift3d.attack.pose import PoseLimits, attack_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import SETTLE_M, attack_shape, standing
from shift3d.detectors.base import Detector
from shift3d.render.settings import REFERENCE, STANDARD
from shift3d.scenes.facts import EffectSettings
from shift3d.scenes.scene import Scene
from shift3d.seeding import derive_seed, generator
from shift3d.task.assets import Assets, load_assets, render_settings, score_precision, search_precision
from shift3d.task.audit import AUDITED, audit
from shift3d.task.rows import Rows
from shift3d.task.scoring import Candidate, score_object
from shift3d.task.spec import TaskResult, TaskSpec

if TYPE_CHECKING:
    from shift3d.render.effects.chain import EffectChain

__all__ = ["build_problem", "load_assets", "run_task"]


def run_task(spec: TaskSpec, assets: Assets) -> TaskResult:
    """Run one task.

    A pure function of the spec and the content that its hashes name, on one thread: the same bytes wherever
    it runs. A scene with no place for the vehicle gives rows with status "no_placement" and no score.

    Raises:
        InputError: a scene or vehicle that cannot be loaded, or is not what the task was planned with.
    Source: SHIFT3D Algorithm 1, sections Setup and Evaluation Metrics.
    """
    start = time.perf_counter()
    rows = Rows(spec)
    placement = place_vehicle(spec, assets)
    rows.time("baseline", "placement", 1e3 * (time.perf_counter() - start))
    if isinstance(placement, NoPlacement):
        for method, replicate in _planned(spec):
            rows.skip(method, replicate, "no_placement")
    else:
        start_effects = time.perf_counter()
        problem = build_problem(spec, assets, placement.theta)
        if spec.effects:  # what they do once: draws, and weather on the scene's own points
            rows.time("baseline", "effects_once", 1e3 * (time.perf_counter() - start_effects))
        searched = assets.detector_of(spec.detector, search_precision(spec))
        others = {name: assets.detector_of(name, score_precision(spec)) for name in spec.scored_by[1:]}
        for candidate in _candidates(spec, problem, searched, rows):
            scored = score_object(problem, candidate.code, candidate.theta, spec.attack.detection_radius_m, others)
            # The reference would only be held against itself.
            audited = candidate.method in AUDITED and problem.settings != REFERENCE
            checked = audit(spec, assets, problem, candidate, scored) if audited else None
            rows.add(candidate, problem.code0, scored, checked)
        for method, replicate in _planned(spec):
            rows.skip(method, replicate, "no_random_pose")
    rows.time("adversarial", "total", 1e3 * (time.perf_counter() - start))
    return rows.result()


def _planned(spec: TaskSpec) -> Iterator[tuple[str, int]]:
    """Every (method, replicate) that a task reports, whatever happens."""
    yield "baseline", 0
    yield from (("random", i) for i in range(spec.attack.random_replicates))
    yield "adversarial", 0
    if spec.mode == "shape":
        yield from (("adversarial_noise", i) for i in range(spec.attack.noise_replicates))


def place_vehicle(spec: TaskSpec, assets: Assets) -> Placement | NoPlacement:
    """Where the vehicle stands: the same for every task of this vehicle, scene and placement settings.

    Whatever the task's mode, weights of the loss, accuracy or detector. Source: our choice: the paper is silent.
    """
    scene, beams = assets.scene(spec)
    vehicle = assets.vehicle(spec)
    limits = PlacementLimits(
        spec.placement.min_range_m,
        spec.placement.max_range_m,
        (spec.placement.sector_centre_rad, spec.placement.sector_half_width_rad),
        spec.placement.attempts,
    )
    # Always at the standard accuracy: a rounding that turns one draw down would put the vehicle elsewhere, and
    # accuracies could no longer be compared object by object.
    sdf = assets.decoder_of(STANDARD.dtype).field(torch.from_numpy(vehicle.latent_code).to(STANDARD.dtype))
    rng = generator("placement", spec.placement_seed)
    constraints, others = _constraints(spec), _other_vehicles(scene)
    space = assets.space_of(spec, STANDARD)
    return place(beams, scene.ground_z_m, sdf, vehicle, rng, limits, constraints, STANDARD, others, space)


def build_problem(spec: TaskSpec, assets: Assets, theta: Tensor) -> AttackProblem:
    """The task's vehicle, placed at ``theta`` (6,), before the detector that scores it.

    Raises:
        InputError: a scene or vehicle that cannot be loaded.
    """
    scene, beams = assets.scene(spec)
    vehicle = assets.vehicle(spec)
    settings = render_settings(spec)
    return AttackProblem(
        beams=beams,
        ground_z_m=scene.ground_z_m,
        field_of=assets.decoder_of(settings.dtype).field,
        vehicle=vehicle,
        detector=assets.detector_of(spec.detector, score_precision(spec)),
        theta0=theta,
        code0=torch.from_numpy(vehicle.latent_code).to(settings.dtype),
        constraints=_constraints(spec),
        settings=settings,
        travel_m=spec.attack.max_shift_m,
        others=_other_vehicles(scene),
        space=assets.space_of(spec, settings),
        effects=_effects(spec, assets),
    )


def _effects(spec: TaskSpec, assets: Assets) -> EffectChain | None:
    """The task's effects; none of their code is imported where there are none.

    Their randomness is that of the placement: shape and pose attacks of one placement have one baseline.
    """
    if not spec.effects:
        return None
    from shift3d.render.effects.chain import EffectChain

    scene, vehicle, settings = assets.scene(spec)[0], assets.vehicle(spec), EffectSettings(**spec.effect_settings)
    heading_rad = _driving_heading_rad(spec, assets) if settings.object_speed_m_s else 0.0
    seed = derive_seed("effects", spec.placement_seed)
    return EffectChain.of(spec.effects, scene, vehicle, seed, settings, heading_rad)


def _driving_heading_rad(spec: TaskSpec, assets: Assets) -> float:
    """A vehicle that drives does so along the heading it was placed with, whatever an attack makes of its pose."""
    placement = place_vehicle(spec, assets)
    return 0.0 if isinstance(placement, NoPlacement) else float(placement.theta[3])


def _constraints(spec: TaskSpec) -> Constraints:
    where = spec.placement
    return Constraints(where.overlap_m, where.contact_m, where.min_object_points)


def _other_vehicles(scene: Scene) -> Tensor:
    """(M, 2) centres of the scene's own vehicles: a box of theirs near the object would pass for a detection of it."""
    return torch.from_numpy(scene.labels.of_class("vehicle").reshape(-1, 7)[:, :2].copy())


def _candidates(spec: TaskSpec, problem: AttackProblem, searched: Detector, rows: Rows) -> Iterator[Candidate]:
    """Baseline, random, adversarial and its noisy copies, in the order of the tables.

    searched: the detector at the precision that is descended.
    """
    yield Candidate("baseline", 0, problem.code0, problem.theta0, best_step=0)
    found = _attack(spec, replace(problem, detector=searched))
    rows.attack(found)
    code, theta = found.latent_code, found.theta
    rng = generator("random", spec.task_id)
    for index in range(spec.attack.random_replicates):
        if spec.mode == "shape":
            radius = float((code.double() - problem.code0.double()).norm())
            drawn_code = random_code(problem.code0, radius, rng)
            yield Candidate("random", index, drawn_code, standing(drawn_code, problem, SETTLE_M))
        elif (drawn := random_pose(problem, rng, _pose_limits(spec))) is not None:
            yield Candidate("random", index, problem.code0, drawn[0])
    yield Candidate("adversarial", 0, code, theta, found.best_step, found.status)
    if spec.mode == "shape":
        rng = generator("noise", spec.task_id)
        noisy = noise_codes(code, spec.attack.noise_sigma, spec.attack.noise_replicates, rng)
        for index, noisy_code in enumerate(noisy):
            yield Candidate("adversarial_noise", index, noisy_code, standing(noisy_code, problem, SETTLE_M))


def _attack(spec: TaskSpec, problem: AttackProblem) -> AttackResult:
    if spec.mode == "shape":
        assert spec.lambda_ is not None
        return attack_shape(problem, spec.lambda_, spec.alpha, spec.attack.steps)
    return attack_pose(problem, spec.alpha, spec.attack.steps, _pose_limits(spec))


def _pose_limits(spec: TaskSpec) -> PoseLimits:
    return PoseLimits(max_shift_m=spec.attack.max_shift_m, max_tilt_rad=spec.attack.max_tilt_rad)
