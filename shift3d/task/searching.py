"""Builds and runs the search of a task: variable, allowed set, and algorithm."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from torch import Tensor

from shift3d.attack.expectation import descend_expectation
from shift3d.attack.gradient_free import evolve, search_by_draws
from shift3d.attack.joint import joint_search
from shift3d.attack.loop import descend
from shift3d.attack.pose import PoseLimits, pose_search
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import shape_search
from shift3d.attack.space import CodeSpace, edited_code, free_space, parameter_space, pca_space
from shift3d.attack.trials import Family, Search, order_by_rarity
from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.task.assets import Assets, kinds_within, require_planned_hash
from shift3d.task.problem import with_other_vehicle
from shift3d.task.spec import TaskSpec
from shift3d.task.transfer import TaskAndProblem, search_scene_problems
from shift3d.vehicles.sources import space_hash
from shift3d.vehicles.vehicle import Vehicle


def search_task(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> AttackResult:
    """Run a task's search within its number of evaluations and return the solution.

    Raises: InputError for a space that the task's vehicles do not have.
    """
    attack = spec.attack
    search, family = _searches(spec, problem, assets)
    rng = generator("search", spec.task_id)
    if attack.search == "expectation":
        placements, starts = attack.placements, attack.starts
        return descend_expectation(problem, search, attack.steps, attack.rate, rng, placements, starts, family=family)
    if attack.search == "evolution":
        return evolve(problem, search, attack.steps, rng)
    if attack.search == "random":
        return search_by_draws(problem, search, attack.steps, rng, family=family)
    return descend(problem, search, attack.steps, spec.alpha, selection_window=attack.selection_window)


def best_of_draws(spec: TaskSpec, problem: AttackProblem, assets: Assets, distance: float) -> AttackResult:
    """Return the best of `attack.steps` draws. distance: see `attack.trials.Search.draw`."""
    rng = generator("random search", spec.task_id)
    search, family = _searches(spec, problem, assets)
    return search_by_draws(problem, search, spec.attack.steps, rng, distance, family=family)


def edited_vehicle(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> Tensor:
    """Return the code of the task's vehicle with the task's parameter edit applied.

    Raises: InputError for a vehicle without parameters, or without this one.
    """
    _require_space(spec, assets)
    box = assets.vehicles.parameters(spec.vehicle)
    return edited_code(problem.code0, box, spec.attack.edit, f"vehicle {spec.vehicle}, attack.edit")


def pose_limits(spec: TaskSpec) -> PoseLimits:
    """Return the limits of a task's pose."""
    return PoseLimits(max_shift_m=spec.attack.max_shift_m, max_tilt_rad=spec.attack.max_tilt_rad)


def _searches(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> tuple[Search, Family | None]:
    """Build the search over the task's own kind, and the family of kinds; None for a search of one kind."""
    if spec.mode == "pose":
        return pose_search(problem, pose_limits(spec)), None
    _require_space(spec, assets)
    elsewhere = search_scene_problems(spec, problem, assets) if spec.mode == "shape" else []
    own = _search(spec, problem, elsewhere, assets, assets.vehicle(spec))
    return own, _family(spec, problem, elsewhere, assets) if spec.attack.space == "family" else None


def _search(
    spec: TaskSpec, problem: AttackProblem, elsewhere: Sequence[TaskAndProblem], assets: Assets, vehicle: Vehicle
) -> Search:
    """Build the search over a vehicle's kind. problem: of that vehicle. elsewhere: of it in other scenes."""
    assert spec.lambda_ is not None
    space = _space(spec, problem, assets, vehicle)
    if spec.mode == "shape":
        search = shape_search(problem, spec.lambda_, space, elsewhere=[there for _, there in elsewhere])
    else:
        search = joint_search(problem, spec.lambda_, space, pose_limits(spec))
    return replace(search, natural=_budget(spec, assets, vehicle))


def _family(spec: TaskSpec, problem: AttackProblem, elsewhere: Sequence[TaskAndProblem], assets: Assets) -> Family:
    """Return every kind of the set within the budget, at the task's places; a kind is built when it is drawn."""
    budget = spec.attack.naturalness
    names = kinds_within(budget, assets.naturalness_of_kinds(spec)) if budget else assets.vehicles.kinds()

    @functools.cache
    def kind(number: int) -> tuple[AttackProblem, Search]:
        vehicle = assets.vehicles.vehicle(names[number])

        def placed(moved: TaskSpec, own: AttackProblem) -> AttackProblem:
            return replace(with_other_vehicle(moved, assets, own, vehicle), detector=problem.detector)

        here, others = placed(spec, problem), [(moved, placed(moved, own)) for moved, own in elsewhere]
        return here, _search(spec, here, others, assets, vehicle)

    codes = np.stack([assets.vehicles.vehicle(name).latent_code for name in names])
    return Family(order_by_rarity(codes, assets.vehicles.codes()), kind)


def _budget(spec: TaskSpec, assets: Assets, vehicle: Vehicle) -> Callable[[Tensor], bool] | None:
    """Return the check that a vehicle's code is within the budget of naturalness; None without a budget."""
    budget, measures = spec.attack.naturalness, assets.naturalness(spec)
    if not budget:
        return None
    where = f"vehicle {vehicle.name}, attack.naturalness={budget:g}"
    own = assets.naturalness_of(spec, vehicle.name)
    if measures is None or own is None:
        raise InputError("the task measures no naturalness", where, "Give naturalness=wide, or attack.naturalness=0")
    if spec.attack.space != "family" and not own.within(budget):
        raise InputError("the unchanged vehicle lies beyond the budget", where, "Give a larger attack.naturalness")
    return lambda code: measures.of_code(vehicle, assets.decoder, code.float()).within(budget)


def _space(spec: TaskSpec, problem: AttackProblem, assets: Assets, vehicle: Vehicle) -> CodeSpace:
    space, source = spec.attack.space, assets.vehicles
    if space == "free":
        return free_space(problem.code0)
    if space == "parameters" or (space == "family" and source.is_parametric(vehicle.name)):
        return parameter_space(problem.code0, source.parameters(vehicle.name))
    where = f"vehicle {vehicle.name}, attack.space={space}"
    return pca_space(problem.code0, source.codes(), spec.attack.components, where, near=space == "family")


def _require_space(spec: TaskSpec, assets: Assets) -> None:
    found = space_hash(assets.vehicles, spec.vehicle, spec.attack.space, bool(spec.attack.edit))
    require_planned_hash(f"the codes of {spec.vehicle}", spec.attack.space_hash, found)
