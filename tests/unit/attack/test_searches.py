"""Searches beside the paper's descent: on an expectation, by evolution, at random, shape and pose together."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, ground_scan, in_frame, soft_car
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.expectation import descend_expectation
from shift3d.attack.gradient_free import evolve, search_by_draws
from shift3d.attack.joint import joint_search
from shift3d.attack.loop import descend
from shift3d.attack.pose import PoseLimits, pose_search
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import shape_search
from shift3d.attack.space import CodeSpace, free_space, pca_space
from shift3d.attack.trials import Family, Search, SearchEvaluator, order_by_rarity
from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import Placement, PlacementContext, PlacementLimits, place
from shift3d.render import Beams, preset

FRAME = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
CODE = torch.zeros(6, dtype=torch.float64)
SETTINGS = preset("standard").with_(dtype=torch.float64)
RULES = Constraints(min_object_points=150)
NEAR = PoseLimits(max_shift_m=0.5, max_tilt_rad=0.0)


def field_of(code: Tensor) -> Field:
    return in_frame(soft_car(code), FRAME)


@pytest.fixture(scope="module")
def problem() -> AttackProblem:
    beams = Beams.from_arrays(*ground_scan(rings=64, columns=600))
    limits = PlacementLimits(8.0, 12.0, attempts=80)
    found = place(
        PlacementContext(beams, -1.73), field_of(CODE), FRAME, np.random.default_rng(3), limits, RULES, SETTINGS
    )
    assert isinstance(found, Placement)
    return AttackProblem(beams, -1.73, field_of, FRAME, WaveDetector(), found.theta, CODE, RULES, SETTINGS)


def small_space(problem: AttackProblem) -> CodeSpace:
    codes = 0.1 * np.random.default_rng(0).standard_normal((200, 6)).astype(np.float32)
    return pca_space(problem.code0, codes, 2, "codes")


def run(problem: AttackProblem, name: str, seed: int = 0) -> AttackResult:
    rng = np.random.default_rng(seed)
    if name == "expectation":
        return descend_expectation(problem, shape_search(problem, 0.0), 8, 0.02, rng, placements=2)
    if name == "evolution":
        return evolve(problem, shape_search(problem, 0.0, small_space(problem)), 12, rng)
    if name == "random":
        return search_by_draws(problem, shape_search(problem, 0.0), 6, rng)
    joint = joint_search(problem, 0.0, free_space(problem.code0), NEAR)
    return descend_expectation(problem, joint, 6, 0.02, rng, placements=1)


NAMES = ("expectation", "evolution", "random", "joint")


@pytest.fixture(scope="module")
def results(problem: AttackProblem) -> dict[str, AttackResult]:
    return {name: run(problem, name) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_a_search_is_decided_by_its_seed(problem: AttackProblem, results: dict[str, AttackResult], name: str) -> None:
    first, again = results[name], run(problem, name)
    assert torch.equal(first.latent_code, again.latent_code) and torch.equal(first.theta, again.theta)
    assert [step.loss for step in first.trace] == [step.loss for step in again.trace]


@pytest.mark.parametrize("name", ["evolution", "random"])
def test_another_seed_draws_others_and_numpys_own_state_is_left_alone(
    problem: AttackProblem, results: dict[str, AttackResult], name: str
) -> None:
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.default_rng(0).random(), np.random.get_state()[1][:4].tolist()  # noqa: NPY002
    first, other = results[name], run(problem, name, 1)
    assert first.trace[1].loss != other.trace[1].loss
    assert np.random.get_state()[1][:4].tolist() == expected[1]  # noqa: NPY002


@pytest.mark.parametrize("name", NAMES)
def test_what_is_kept_is_valid_and_the_lowest(results: dict[str, AttackResult], name: str) -> None:
    found = results[name]
    assert found.status == "ok" and found.best.valid and found.best_step >= 1
    assert found.best.loss == min(step.loss for step in found.trace[1:] if step.valid)


@pytest.mark.parametrize(("name", "evaluations"), [("evolution", 12), ("random", 6), ("expectation", 4)])
def test_no_search_takes_more_steps_than_it_was_given(
    results: dict[str, AttackResult], name: str, evaluations: int
) -> None:
    # A step on an expectation over two places takes two of the 8 given evaluations.
    assert len(results[name].trace) == 1 + evaluations


@pytest.mark.parametrize(("evaluations", "starts", "steps"), [(0, 1, 0), (1, 1, 0), (3, 1, 1), (0, 3, 2), (3, 3, 2)])
def test_evaluations_that_are_too_few_for_a_step_take_none(
    problem: AttackProblem, evaluations: int, starts: int, steps: int
) -> None:
    """A step over two placements takes two evaluations; every start takes one."""
    search, rng = shape_search(problem, 0.0, small_space(problem)), np.random.default_rng(0)
    found = descend_expectation(problem, search, evaluations, 0.02, rng, placements=2, starts=starts)
    assert len(found.trace) == 1 + steps


def test_the_mean_over_placements_is_what_is_descended(problem: AttackProblem) -> None:
    search = shape_search(problem, 0.0)
    alone = descend_expectation(problem, search, 4, 0.02, np.random.default_rng(0), placements=1)
    mean = descend_expectation(problem, search, 8, 0.02, np.random.default_rng(0), placements=2)
    assert alone.trace[0].loss == alone.trace[0].adversarial_loss
    assert mean.trace[0].adversarial_loss == alone.trace[0].adversarial_loss
    assert mean.trace[0].loss != mean.trace[0].adversarial_loss


def test_a_descent_on_the_expectation_lowers_it(problem: AttackProblem) -> None:
    found = descend_expectation(problem, shape_search(problem, 0.0), 20, 0.05, np.random.default_rng(0), placements=2)
    losses = [step.loss for step in found.trace]
    assert np.mean(losses[-4:]) < np.mean(losses[:4])


def test_the_descent_begins_at_the_best_of_the_baseline_and_its_draws(problem: AttackProblem) -> None:
    rng = np.random.default_rng(0)
    found = descend_expectation(problem, shape_search(problem, 0.0), 12, 0.02, rng, placements=1, starts=5)
    assert len(found.trace) == 13
    assert found.trace[0].latent_distance == 0.0
    assert [step.latent_distance for step in found.trace[1:5]] == pytest.approx([0.2] * 4, rel=1e-6)
    best = min((step for step in found.trace[:5] if step.valid), key=lambda step: step.loss)
    # Another rendering of the same shape, from other hits: equal to their tolerance.
    assert found.trace[5].loss == pytest.approx(best.loss, rel=1e-3)


def test_the_loss_of_a_universal_shape_is_the_mean_over_its_places(problem: AttackProblem) -> None:
    moved = problem.theta0.clone()
    moved[3] += 0.7
    other = replace(problem, theta0=moved)
    both = shape_search(problem, 0.5, elsewhere=[other])
    trials = SearchEvaluator(problem, both)
    here, there = SearchEvaluator(problem, shape_search(problem, 0.5)), SearchEvaluator(other, shape_search(other, 0.5))
    code = problem.code0 + 0.05
    gradient = trials.evaluate(code, True)
    parts = [alone.evaluate(code, True) for alone in (here, there)]
    assert gradient is not None and parts[0] is not None and parts[1] is not None
    assert here.trace[0].loss != there.trace[0].loss
    assert trials.trace[0].loss == pytest.approx((here.trace[0].loss + there.trace[0].loss) / 2, rel=1e-12)
    assert trials.trace[0].adversarial_loss == here.trace[0].adversarial_loss
    assert torch.allclose(gradient, (parts[0] + parts[1]) / 2, rtol=1e-9, atol=0.0)


def test_a_universal_search_lowers_the_mean(problem: AttackProblem) -> None:
    moved = problem.theta0.clone()
    moved[3] += 0.7
    search = shape_search(problem, 0.0, elsewhere=[replace(problem, theta0=moved)])
    found = descend_expectation(problem, search, 10, 0.05, np.random.default_rng(0), placements=1)
    assert found.best.loss < found.trace[0].loss


def near_search(problem: AttackProblem, longest: float, distances: list[float] | None = None) -> Search:
    """Return a search over every code; codes no farther than `longest` from the baseline's are natural."""

    def natural(code: Tensor) -> bool:
        distance = float((code - problem.code0).norm())
        if distances is not None:
            distances.append(distance)
        return distance <= longest

    return replace(shape_search(problem, 0.0), natural=natural)


@pytest.mark.parametrize("name", ["expectation", "evolution", "random", "descent"])
def test_no_search_keeps_what_lies_beyond_its_budget(problem: AttackProblem, name: str) -> None:
    distances: list[float] = []
    search, rng = near_search(problem, 0.15, distances), np.random.default_rng(0)
    found = {
        "expectation": lambda: descend_expectation(problem, search, 12, 0.05, rng, placements=1, starts=4),
        "evolution": lambda: evolve(problem, search, 10, rng),
        "random": lambda: search_by_draws(problem, search, 8, rng),
        "descent": lambda: descend(problem, search, 8, 0.05),
    }[name]()
    assert max(distances) > 0.15, "the budget was met"
    assert found.best.latent_distance <= 0.15 + 1e-9
    for step in found.trace[1:]:
        assert not step.valid or step.latent_distance <= 0.15 or step.loss >= found.best.loss


def test_a_step_beyond_the_budget_goes_half_way_back_to_the_best(problem: AttackProblem) -> None:
    found = descend(problem, near_search(problem, 1e-6), 2, 0.01)
    first, second = (step.latent_distance for step in found.trace[1:])
    assert not found.trace[1].within_budget
    assert second == pytest.approx(first / 2, rel=1e-3)
    assert found.status == "no_valid_step" and found.best_step == 0


def two_kinds(problem: AttackProblem) -> Family:
    """Return a family of the problem's own vehicle and one with another code."""
    other = replace(problem, code0=problem.code0 + 0.05, vehicle=replace(FRAME))
    kinds = [(problem, shape_search(problem, 0.0)), (other, shape_search(other, 0.0))]
    return Family((1, 0), lambda kind: kinds[kind])


def test_a_search_over_kinds_goes_on_with_the_kind_of_its_best_start(problem: AttackProblem) -> None:
    family, rng = two_kinds(problem), np.random.default_rng(3)
    found = descend_expectation(problem, family.of(0)[1], 9, 0.02, rng, placements=1, starts=5, family=family)
    drawn = found.trace[1:5]
    # The other kind comes first; draws are 0.2 from their own kind's code, distances are from the start's code.
    own = [step.latent_distance == pytest.approx(0.2, rel=1e-6) for step in drawn]
    assert own[:2] == [False, True] and sorted(own[2:]) == [False, True], "each of the two again, the better one first"
    assert own[2] == (drawn[1].loss < drawn[0].loss)
    best = min((step for step in drawn if step.valid), key=lambda step: step.loss)
    assert found.trace[5].loss == pytest.approx(best.loss, rel=1e-3)
    away = found.latent_code - problem.code0
    assert float(away.double().norm()) == pytest.approx(found.best.latent_distance, rel=1e-5)
    assert found.best.loss <= best.loss


def test_the_second_half_of_the_starts_is_of_the_three_best_kinds_of_the_first(problem: AttackProblem) -> None:
    turns: list[int] = []
    kinds = [shape_search(problem, weight) for weight in (5e3, 1e3, 3e3, 2e3, 4e3, 0.0)]

    def kind(number: int) -> tuple[AttackProblem, Search]:
        turns.append(number)
        return problem, kinds[number]

    family, rng = Family((4, 0, 3, 1, 2, 5), kind), np.random.default_rng(0)
    descend_expectation(problem, kinds[0], 11, 0.02, rng, placements=1, starts=11, family=family)
    assert turns == [4, 0, 3, 1, 2, *(1, 3, 2), *(1, 3)], "5, the best of all, had no turn"


def test_the_most_unusual_kind_is_the_one_farthest_from_the_mean_of_the_known_codes() -> None:
    known = np.array([[0, 0], [2, 0]], np.float32)
    assert order_by_rarity(np.array([[1, 0.5], [1, -3], [4, 0], [1, 3]], np.float32), known) == (1, 2, 3, 0)


def test_draws_over_kinds_hand_back_the_vehicle_of_the_best(problem: AttackProblem) -> None:
    family = two_kinds(problem)
    found = search_by_draws(problem, family.of(0)[1], 6, np.random.default_rng(1), family=family)
    valid = [step for step in found.trace[1:] if step.valid]
    assert found.best.loss == min(step.loss for step in valid)
    again = SearchEvaluator(*next(kind for kind in map(family.of, range(2)) if kind[0].vehicle is found.vehicle))
    again.evaluate(found.latent_code, False)
    assert again.trace[0].loss == pytest.approx(found.best.loss, rel=1e-6)


def test_shape_and_pose_move_together_and_within_their_limits(
    problem: AttackProblem, results: dict[str, AttackResult]
) -> None:
    last = results["joint"].trace[-1]
    assert last.latent_distance > 0.0
    start = problem.theta0
    assert 0.0 < float(torch.tensor(last.theta[:2]).sub(start[:2]).norm()) <= NEAR.max_shift_m + 1e-9
    assert last.theta[4:] == tuple(start[4:].tolist())  # level: no tilt was allowed


def test_with_one_of_both_held_the_joint_loss_is_that_of_the_other(problem: AttackProblem) -> None:
    joint = joint_search(problem, 0.5, free_space(problem.code0), NEAR)
    shape, pose = shape_search(problem, 0.5, snap_m=0.0), pose_search(problem, NEAR)
    code, theta = joint.parameters(joint.start)
    assert torch.equal(code, shape.start) and torch.equal(theta, pose.start)
    moved = joint.start.clone()
    moved[0] += 0.3
    assert float(joint.penalty(moved)) == pytest.approx(0.5 * 0.3**2)


def test_evolution_ranks_what_is_not_valid_last(problem: AttackProblem) -> None:
    strict = replace(problem, constraints=Constraints(min_object_points=10**6))
    found = evolve(strict, shape_search(strict, 0.0, small_space(strict)), 6, np.random.default_rng(0))
    assert found.status == "no_valid_step" and found.best_step == 0


def test_the_unchanged_vehicle_is_no_solution_however_often_it_is_tried(problem: AttackProblem) -> None:
    heavy = shape_search(problem, 1e6)  # every move costs more than it gains: the descent begins at the vehicle
    found = descend_expectation(problem, heavy, 4, 0.02, np.random.default_rng(0), placements=1, starts=2)
    again = [record.step for record in found.trace if record.is_start]
    assert again == [0, 2] and found.status == "ok"
    assert found.best_step not in again and found.best.latent_distance > 0 and not torch.equal(found.latent_code, CODE)


def test_a_budget_is_asked_of_what_follows_a_vehicle_that_came_again(problem: AttackProblem) -> None:
    lengths: list[float] = []

    def natural(code: Tensor) -> bool:
        lengths.append(float(code.norm()))
        return False

    heavy = replace(shape_search(problem, 1e6), natural=natural)
    found = descend_expectation(problem, heavy, 4, 0.02, np.random.default_rng(0), placements=1, starts=2)
    assert lengths and 0.0 not in lengths
    assert found.status == "no_valid_step" and torch.equal(found.latent_code, CODE)
