"""The search that a task asks for: what is searched, where it may go, and how."""

from __future__ import annotations

from torch import Tensor

from shift3d.attack.expectation import descend_expectation
from shift3d.attack.joint import joint_search
from shift3d.attack.loop import descend
from shift3d.attack.pose import PoseLimits, pose_search
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.score_only import draw_best, evolve
from shift3d.attack.shape import shape_search
from shift3d.attack.space import CodeSpace, edited_code, free_space, parameter_space, pca_space, within_budget
from shift3d.attack.trials import Search
from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.task.assets import Assets, require_planned
from shift3d.task.spec import TaskSpec
from shift3d.task.transfer import problems_elsewhere
from shift3d.vehicles.sources import space_hash

__all__ = ["best_of_draws", "edited_vehicle", "pose_limits", "search_task"]


def search_task(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> AttackResult:
    """The solution of a task's search, within its number of evaluations.

    Raises: InputError for a space that the task's vehicles do not have.
    """
    attack = spec.attack
    problem = problem if spec.mode == "shape" else problem.with_space()
    search = _search(spec, problem, assets)
    rng = generator("search", spec.task_id)
    if attack.search == "expectation":
        return descend_expectation(problem, search, attack.steps, attack.rate, rng, attack.placements, attack.starts)
    if attack.search == "evolution":
        return evolve(problem, search, attack.steps, rng)
    if attack.search == "random":
        return draw_best(problem, search, attack.steps, rng)
    return descend(problem, search, attack.steps, spec.alpha, selection_window=attack.selection_window)


def best_of_draws(spec: TaskSpec, problem: AttackProblem, assets: Assets, distance: float) -> AttackResult:
    """The best of as many draws as the task's search has evaluations. distance: see `attack.trials.Search.draw`."""
    problem = problem if spec.mode == "shape" else problem.with_space()
    rng = generator("random search", spec.task_id)
    return draw_best(problem, _search(spec, problem, assets), spec.attack.steps, rng, distance)


def edited_vehicle(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> Tensor:
    """The code of the task's vehicle with the parameters of its edit put elsewhere.

    Raises: InputError for a vehicle that is made of no parameters, or not of these.
    """
    _require_space(spec, assets)
    box = assets.vehicles.parameters(spec.vehicle)
    return edited_code(problem.code0, box, spec.attack.edit, f"vehicle {spec.vehicle}, attack.edit")


def pose_limits(spec: TaskSpec) -> PoseLimits:
    """Where a task's pose may go."""
    return PoseLimits(max_shift_m=spec.attack.max_shift_m, max_tilt_rad=spec.attack.max_tilt_rad)


def _search(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> Search:
    if spec.mode == "pose":
        return pose_search(problem, pose_limits(spec))
    assert spec.lambda_ is not None
    space = _space(spec, problem, assets)
    if spec.mode == "shape":
        return shape_search(problem, spec.lambda_, space, elsewhere=problems_elsewhere(spec, problem, assets))
    return joint_search(problem, spec.lambda_, space, pose_limits(spec))


def _space(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> CodeSpace:
    space = _unbounded_space(spec, problem, assets)
    budget = spec.attack.naturalness
    if not budget:
        return space
    vehicle, measures = assets.vehicle(spec), assets.naturalness(spec)
    where = f"vehicle {spec.vehicle}, attack.naturalness={budget:g}"
    if measures is None:
        raise InputError("the task measures no naturalness", where, "Give naturalness=wide, or attack.naturalness=0")

    def natural(code: Tensor) -> bool:
        return measures.of_code(vehicle, assets.decoder, code.float()).within(budget)

    return within_budget(space, natural, where)


def _unbounded_space(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> CodeSpace:
    _require_space(spec, assets)
    if spec.attack.space == "pca":
        codes = assets.vehicles.codes()
        return pca_space(problem.code0, codes, spec.attack.components, f"vehicle {spec.vehicle}, attack.space=pca")
    if spec.attack.space == "parameters":
        return parameter_space(problem.code0, assets.vehicles.parameters(spec.vehicle))
    return free_space(problem.code0)


def _require_space(spec: TaskSpec, assets: Assets) -> None:
    found = space_hash(assets.vehicles, spec.vehicle, spec.attack.space, bool(spec.attack.edit))
    require_planned(f"the codes of {spec.vehicle}", spec.attack.space_hash, found)
