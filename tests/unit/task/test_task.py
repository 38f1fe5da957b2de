"""One real task with shipped weights, a procedural street and a short search: properties for any numbers."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from pathlib import Path

import pytest
import torch
from short_tasks import KNOWN, SHORT, STREET, by_method, make_spec, with_vehicles
from toy_detector import WaveDetector

from shift3d.attack.records import AttackResult, StepRecord
from shift3d.errors import InputError
from shift3d.placement.constraints import ConstraintCheck
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.store.arrays import write_safetensors
from shift3d.store.tables import table_from_rows
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.rows import Rows
from shift3d.task.run import run_task
from shift3d.task.spec import AttackSpec, PlacementSpec
from shift3d.vehicles.sources import vehicle_hash
from shift3d.vehicles.vehicle import DEFAULT_VEHICLES, baseline_vehicles, read_tensors


def test_every_method_is_reported_once(shape: TaskResult, pose: TaskResult) -> None:
    keys = [(row["method"], row["replicate"]) for row in shape.scores]
    assert keys == [
        ("baseline", 0),
        ("random", 0),
        ("adversarial", 0),
        ("adversarial_noise", 0),
        ("adversarial_noise", 1),
    ]
    assert sorted(row["method"] for row in pose.scores) == ["adversarial", "baseline", "random"]
    assert len(shape.solutions) == len(shape.scores)


def test_scores_are_probabilities_and_residuals_are_on_the_surface(shape: TaskResult) -> None:
    for row in shape.scores:
        assert 0.0 <= row["score"] <= 1.0
        assert row["adversarial_loss"] >= 0.0
        assert row["max_residual_m"] < 1e-3


def test_the_baseline_stands_where_the_paper_allows(shape: TaskResult) -> None:
    (row,) = by_method(shape, "baseline")
    assert 15.0 <= row["range_m"] <= 50.0
    assert row["range_m"] == pytest.approx(math.hypot(row["x_m"], row["y_m"]))
    assert row["object_points"] >= 300
    assert row["overlap_ok"] and row["contact_ok"]
    assert row["latent_distance"] == 0.0


def test_random_shape_lies_as_far_from_the_baseline_as_the_adversarial_one(shape: TaskResult) -> None:
    (random,), (adversarial,) = by_method(shape, "random"), by_method(shape, "adversarial")
    assert random["latent_distance"] == pytest.approx(adversarial["latent_distance"], rel=1e-5)


def test_shape_and_pose_start_from_the_same_object(shape: TaskResult, pose: TaskResult) -> None:
    (a,), (b,) = by_method(shape, "baseline"), by_method(pose, "baseline")
    assert a == b


def test_pose_stays_in_its_ball_and_keeps_the_shape(pose: TaskResult) -> None:
    (start,), (found,) = by_method(pose, "baseline"), by_method(pose, "adversarial")
    assert math.hypot(found["x_m"] - start["x_m"], found["y_m"] - start["y_m"]) <= 4.0 + 1e-9
    assert abs(found["pitch_rad"] - start["pitch_rad"]) <= 0.1 + 1e-9
    assert abs(found["roll_rad"] - start["roll_rad"]) <= 0.1 + 1e-9
    assert found["latent_distance"] == 0.0


def test_the_search_lowers_the_loss(shape: TaskResult) -> None:
    (start,), (found,) = by_method(shape, "baseline"), by_method(shape, "adversarial")
    assert found["status"] == "ok" and 1 <= found["best_step"] <= SHORT.steps
    assert found["adversarial_loss"] < start["adversarial_loss"]


def test_a_scene_without_room_is_reported_not_dropped(assets: Assets) -> None:
    nowhere = PlacementSpec(min_range_m=49.0, max_range_m=50.0, attempts=3)
    result = run_task(make_spec(placement=nowhere), assets)
    assert len(result.scores) == 5
    assert {row["status"] for row in result.scores} == {"no_placement"}
    assert all("score" not in row for row in result.scores)
    assert result.solutions == []


def test_unknown_vehicle_is_one_clear_line(assets: Assets) -> None:
    with pytest.raises(InputError, match=r"unknown vehicle 'tank'.*Choose from"):
        run_task(make_spec(vehicle="tank"), assets)


def test_float64_scores_agree_with_float32(assets: Assets, shape: TaskResult) -> None:
    """The reference preset in double precision starts from the same object and finds the same hits."""
    accuracy = accuracy_settings(AccuracyConfig(name="reference", render={}))
    spec = make_spec(
        accuracy="reference",
        accuracy_settings=accuracy,
        attack=AttackSpec(steps=0, noise_replicates=0, random_replicates=0),
    )
    with torch.random.fork_rng():
        result = run_task(spec, assets)
    (exact,), (fast,) = by_method(result, "baseline"), by_method(shape, "baseline")
    assert exact["x_m"] == fast["x_m"]
    assert abs(exact["object_points"] - fast["object_points"]) <= 0.005 * exact["object_points"] + 1
    assert exact["score"] == pytest.approx(fast["score"], abs=0.02)


def test_weights_of_another_network_are_refused_before_any_task() -> None:
    foreign = Path(__file__).parents[3] / "shift3d" / "weights" / "sdf.safetensors"
    with pytest.raises(InputError, match=r"sdf\.safetensors: tensor backbone.* is missing"):
        load_assets(AssetsSpec(scenes=STREET, detectors={"pointpillars": str(foreign)}))


def test_content_that_changed_after_planning_is_refused(assets: Assets) -> None:
    scene, _ = assets.scene(make_spec())
    planned = {"scene_hash": scene.content_hash(), "vehicle_hash": vehicle_hash(assets.vehicle(make_spec()))}
    assert assets.scene(make_spec(**planned))[0] is scene
    for field in planned:
        name = field.removesuffix("_hash")
        with pytest.raises(InputError, match=rf"{name} \S+: changed after the sweep was planned.*out=DIR"):
            run_task(make_spec(**{**planned, field: "another"}), assets)
    for what in ("decoder", "pointpillars"):
        with pytest.raises(InputError, match=rf"{what}: changed after the sweep was planned"):
            load_assets(AssetsSpec(scenes=STREET, hashes={what: "another"}))


def test_a_vehicle_whose_box_contradicts_its_shape_is_refused(assets: Assets, tmp_path: Path) -> None:
    shutil.copy(DEFAULT_VEHICLES.parent / "sdf.safetensors", tmp_path)
    tensors, metadata, _ = read_tensors(None)
    baselines = json.loads(metadata["baselines"])
    baselines["suv"]["size_m"][2] += 0.2
    write_safetensors(tmp_path / "vehicles.safetensors", tensors, metadata | {"baselines": json.dumps(baselines)})
    with pytest.raises(InputError, match=r"vehicles\.safetensors: 'suv': its decoded shape ends 0\.10 m off its box"):
        run_task(make_spec(), with_vehicles(assets, str(tmp_path)))


def with_second_detector(assets: Assets, name: str) -> Assets:
    """Return the same assets, and a small detector under the second name, whose weights need not ship."""
    wave = WaveDetector()
    wave.name = name
    both = dataclasses.replace(assets, detectors={**assets.detectors, name: None})
    return dataclasses.replace(
        both, _detectors={**assets._detectors, (name, "float32"): wave, (name, "bfloat16"): wave}
    )


@pytest.fixture(scope="module")
def scored_by_both(assets: Assets) -> TaskResult:
    attack = AttackSpec(steps=1, random_replicates=0, noise_replicates=1, noise_share=0.05)
    return run_task(make_spec(scored_by=("sst",), attack=attack), with_second_detector(assets, "sst"))


def test_every_solution_is_scored_by_every_detector_on_one_rendering(
    scored_by_both: TaskResult, shape: TaskResult
) -> None:
    result = scored_by_both
    first, second = ([row for row in result.scores if row["scored_by"] == name] for name in ("pointpillars", "sst"))
    assert len(first) == len(second) == len(result.solutions) == 3
    for one, other in zip(first, second):
        differing = {key for key in one if one[key] != other[key]}
        assert differing == {"scored_by", "score", "adversarial_loss"}
        assert 0.0 < other["score"] < 1.0
    assert first[0] == by_method(shape, "baseline")[0]
    stages = {(row["method"], row["stage"]): row["calls"] for row in result.timings}
    assert stages["adversarial_noise", "scored_by_sst"] == stages["adversarial_noise", "detector"] == 1


def test_any_detector_can_be_attacked(assets: Assets) -> None:
    spec = make_spec(
        detector="sst", scored_by=("pointpillars",), attack=AttackSpec(steps=1, random_replicates=0, noise_replicates=0)
    )
    result = run_task(spec, with_second_detector(assets, "sst"))
    assert [row["scored_by"] for row in result.scores] == ["sst", "pointpillars"] * 2
    start, found = (
        next(row for row in by_method(result, method) if row["scored_by"] == "sst")
        for method in ("baseline", "adversarial")
    )
    assert found["status"] == "ok" and found["adversarial_loss"] < start["adversarial_loss"]


def test_a_gap_is_a_row_for_every_detector(assets: Assets) -> None:
    nowhere = PlacementSpec(min_range_m=49.0, max_range_m=50.0, attempts=1)
    spec = make_spec(placement=nowhere, scored_by=("sst",))
    result = run_task(spec, with_second_detector(assets, "sst"))
    assert [row["scored_by"] for row in result.scores] == ["pointpillars", "sst"] * 5


def test_rows_say_how_the_search_stood_numerically(shape: TaskResult, pose: TaskResult) -> None:
    for result in (shape, pose):
        assert [row["non_finite"] for row in result.scores] == [0] * len(result.scores)
        for row in result.scores:
            if row["method"] in ("baseline", "adversarial"):
                assert 0.0 < row["least_slope"] <= 2.0  # |e . grad g| of a field that is nearly a distance
            else:
                assert "least_slope" not in row and "grazing_gradient" not in row
        (start,) = by_method(result, "baseline")
        assert 0.0 <= start["grazing_gradient"] <= 1.0


def test_the_path_of_a_search_leads_from_the_baseline_to_its_solution(shape: TaskResult, pose: TaskResult) -> None:
    for result in (shape, pose):
        path = result.trajectories
        assert [row["step"] for row in path] == list(range(SHORT.steps + 1))
        (start,), (found,) = by_method(result, "baseline"), by_method(result, "adversarial")
        kept = [row for row in path if row["kept"]]
        assert [row["step"] for row in kept] == [found["best_step"]] and kept[0]["valid"]
        for row, scored in ((path[0], start), (kept[0], found)):
            same = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad", "latent_distance")
            assert [row[name] for name in same] == [scored[name] for name in same]
            assert row["object_points"] == pytest.approx(scored["object_points"], rel=0.01)
            # The search's window and precision are not those of the score.
            assert row["adversarial_loss"] == pytest.approx(scored["adversarial_loss"], rel=0.05)
            assert row["proposal_score"] == pytest.approx(scored["score"], abs=0.05)
        weight = 1.0 if result is shape else 0.0
        for row in path:
            expected = row["adversarial_loss"] + weight * row["latent_distance"] ** 2
            assert row["loss"] == pytest.approx(expected, rel=1e-5)


def test_nothing_placed_has_no_path(assets: Assets) -> None:
    nowhere = PlacementSpec(min_range_m=49.0, max_range_m=50.0, attempts=1)
    assert run_task(make_spec(placement=nowhere), assets).trajectories == []


def test_a_step_that_is_not_finite_has_no_number_and_still_has_its_row() -> None:
    check = ConstraintCheck(0.0, 0.0, 400, True, True, True)
    record = StepRecord(3, (1.0,) * 6, 0.5, math.inf, math.nan, 0.4, check, 0, 0.0, 10)
    rows = Rows(make_spec())
    rows.attack(AttackResult(baseline_vehicles()["suv"], torch.zeros(4), torch.zeros(6), 0, "diverged", (record,)))
    (row,) = rows.result().trajectories
    assert (row["loss"], row["adversarial_loss"], row["proposal_score"]) == (None, None, 0.4)
    assert not row["kept"]
    assert table_from_rows("trajectories", [row | KNOWN]).num_rows == 1


def test_noise_is_as_far_as_its_share_of_the_way_to_the_solution(scored_by_both: TaskResult) -> None:
    (way,) = {row["latent_distance"] for row in by_method(scored_by_both, "adversarial")}
    codes = {row["method"]: torch.tensor(row["latent_code"]) for row in scored_by_both.solutions}
    noise = codes["adversarial_noise"] - codes["adversarial"]
    assert float(noise.std()) == pytest.approx(0.05 * way, rel=0.15)
