"""A solution of one scene, put into another."""

from __future__ import annotations

import math

import pytest
import torch
from short_tasks import THERE, by_method, make_spec

from shift3d.attack.shape import SNAP_M, on_ground
from shift3d.errors import InputError
from shift3d.placement.sampling import Placement
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import completed_rows
from shift3d.task.assets import Assets
from shift3d.task.exchange import Row, TaskResult
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.run import run_task
from shift3d.task.scoring import score_object
from shift3d.task.spec import AttackSpec, PlacementSpec, TransferScene
from shift3d.task.transfer import score_transfers

TRANSFER = (TransferScene(THERE, ""),)


def test_baseline_and_shape_are_scored_at_one_place_of_the_other_scene(moved: TaskResult, assets: Assets) -> None:
    (row,) = moved.transfers
    assert (row["other_scene"], row["status"], row["scored_by"]) == (THERE, "ok", "pointpillars")
    assert 15.0 <= row["range_m"] <= 50.0 and row["object_points_baseline"] >= 300
    assert row["range_m"] == pytest.approx(math.hypot(row["x_m"], row["y_m"]))
    # Both scores again, from the solution that the task reports and the place that the row states.
    there = make_spec(transfer_scenes=TRANSFER).moved_to(TRANSFER[0])
    pose = [row[name] for name in ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")]
    theta = torch.tensor(pose, dtype=torch.float64)
    problem = build_problem(there, assets, theta)
    code = torch.tensor(solution(moved, "adversarial")["latent_code"])
    assert score_object(problem, problem.code0, theta, 5.0).results["pointpillars"].score == row["score_baseline"]
    stands = on_ground(code, problem, SNAP_M)
    assert torch.equal(stands[[0, 1, 3, 4, 5]], theta[[0, 1, 3, 4, 5]]) and float(stands[2]) == row["z_shape_m"]
    assert score_object(problem, code, stands, 5.0).results["pointpillars"].score == row["score"]


def test_the_unchanged_shape_changes_no_score_anywhere(assets: Assets) -> None:
    code = torch.from_numpy(assets.vehicle(make_spec()).latent_code)
    (row,) = score_transfers(make_spec(transfer_scenes=TRANSFER), assets, code)
    assert row["score"] == pytest.approx(row["score_baseline"], abs=0.02)  # snapped to the ground again, by millimetres


def test_transfers_are_beside_the_task_and_change_nothing_else(moved: TaskResult, shape: TaskResult) -> None:
    assert shape.transfers == []
    # The search is the same; random draws depend on the task's id.
    for method in ("baseline", "adversarial"):
        assert by_method(moved, method) == by_method(shape, method)
        assert [solution(result, method) for result in (moved, shape)] == [solution(shape, method)] * 2


def solution(result: TaskResult, method: str) -> Row:
    (found,) = (row for row in result.solutions if row["method"] == method)
    return found


def test_rows_fit_their_table(moved: TaskResult) -> None:
    rows = completed_rows(make_spec(transfer_scenes=TRANSFER), "sweep", moved)["transfers"]
    assert table_from_rows("transfers", rows).num_rows == 1


def test_a_scene_without_room_is_a_row_without_scores(assets: Assets) -> None:
    nowhere = make_spec(
        transfer_scenes=TRANSFER, placement=PlacementSpec(min_range_m=49.0, max_range_m=50.0, attempts=1)
    )
    code = torch.from_numpy(assets.vehicle(nowhere).latent_code)
    (row,) = score_transfers(nowhere, assets, code)
    assert row["status"] == "no_placement" and "score" not in row
    assert table_from_rows(
        "transfers", completed_rows(nowhere, "s", TaskResult([], [], [], transfers=[row]))["transfers"]
    )


def test_another_scene_that_changed_after_planning_is_refused(assets: Assets) -> None:
    code = torch.from_numpy(assets.vehicle(make_spec()).latent_code)
    with pytest.raises(InputError, match=rf"scene {THERE}: changed after the sweep was planned"):
        list(score_transfers(make_spec(transfer_scenes=(TransferScene(THERE, "another"),)), assets, code))


def test_a_scene_that_was_searched_in_judges_nothing(assets: Assets) -> None:
    short = AttackSpec(steps=0, noise_replicates=0, random_replicates=0, search_scenes=1)
    spec = make_spec(transfer_scenes=TRANSFER, attack=short)
    found = run_task(spec, assets)
    assert found.transfers == [] and spec.search == "descent_universal2" and searched_in(found) == [1]
    there = spec.moved_to(TRANSFER[0])
    placement = place_vehicle(there, assets)
    assert isinstance(placement, Placement)
    problem = build_problem(there, assets, placement.theta)
    alone = score_object(problem, problem.code0, placement.theta, 5.0).results["pointpillars"].adversarial_loss
    first = found.trajectories[0]
    # Scored again at its place; the search rendered it partly in bfloat16, to a few thousandths.
    assert first["loss"] == pytest.approx((first["adversarial_loss"] + alone) / 2, rel=0.02)


def test_a_scene_without_room_is_counted_where_a_universal_shape_is_searched(assets: Assets) -> None:
    short = AttackSpec(steps=0, noise_replicates=0, random_replicates=0, search_scenes=1)
    # Three draws find a place in its own scene, and none in the other.
    few = make_spec(transfer_scenes=TRANSFER, attack=short, replicate=1, placement=PlacementSpec(attempts=3))
    found = run_task(few, assets)
    assert by_method(found, "adversarial")[0]["score"] is not None and searched_in(found) == [0]


def searched_in(found: TaskResult) -> list[int]:
    return [row["calls"] for row in found.timings if row["stage"] == "search_scenes"]
