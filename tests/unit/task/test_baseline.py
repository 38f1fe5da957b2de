"""Tasks that differ in their search alone share a baseline: a worker measures it once, without effect on any byte."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from short_tasks import SHORT, THERE, make_spec, with_own_caches

from shift3d.task.assets import Assets
from shift3d.task.exchange import TaskResult
from shift3d.task.problem import place_vehicle, placed_pose
from shift3d.task.run import run_task
from shift3d.task.spec import PlacementSpec, TransferScene

METHODS = ("baseline", "adversarial")
BOTH = ("pointpillars", "sst_small")


def baseline_stages(result: TaskResult) -> dict[str, float]:
    return {row["stage"]: row["milliseconds"] for row in result.timings if row["method"] == "baseline"}


def without_times(result: TaskResult) -> dict[str, list]:
    return {name: rows for name, rows in vars(result).items() if name != "timings"}


def test_the_second_task_spends_nothing_on_it_and_finds_what_it_would_alone(assets: Assets) -> None:
    """Two workers run the same two specs in opposite order and give the same rows."""
    short = replace(SHORT, steps=1, random_replicates=0, noise_replicates=1)
    specs = make_spec(transfer_scenes=(TransferScene(THERE, ""),), attack=short), make_spec("pose", attack=short)
    one, other = (with_own_caches(assets) for _ in range(2))
    first, second = (run_task(spec, one) for spec in specs)
    assert baseline_stages(first).keys() >= {"placement", "render", "detector", "audit"}
    assert sum(baseline_stages(second).values()) == 0.0
    alone, after = (run_task(spec, other) for spec in reversed(specs))
    assert first.transfers and without_times(first) == without_times(after)
    assert without_times(second) == without_times(alone)


def test_a_search_without_a_step_is_its_baseline_scored_once(assets: Assets) -> None:
    spec = make_spec(attack=replace(SHORT, steps=0, random_replicates=0, noise_replicates=0), scored_by=BOTH)
    result = run_task(spec, assets)
    baseline, found = ([row for row in result.scores if row["method"] == method] for method in METHODS)
    assert [row["score"] for row in found] == [row["score"] for row in baseline]
    assert len(found) == 2 and found[0]["audited_beams"] > 0
    stages = {method: {row["stage"] for row in result.timings if row["method"] == method} for method in METHODS}
    assert "scored_by_sst_small" in stages["baseline"] - stages["adversarial"]


def test_a_place_is_looked_for_once_a_worker(assets: Assets) -> None:
    """Tasks of another accuracy, detector or search share the place, and so do effects of a vehicle that drives."""
    fresh = replace(assets, poses={})
    expected = place_vehicle(make_spec(), fresh).theta  # type: ignore[union-attr]
    alike = [
        make_spec(),
        make_spec("pose"),
        make_spec(detector="sst", accuracy_settings={}),
        make_spec(effects=("fog",)),
    ]
    for spec in alike:
        pose = placed_pose(spec, fresh)
        assert pose is not None and torch.equal(pose, expected)
        pose += 1.0  # of its owner
    nowhere = make_spec(placement=PlacementSpec(min_object_points=1_000_000, attempts=2))
    assert placed_pose(nowhere, fresh) is None
    here, there = fresh.poses
    fresh.poses |= {here: expected + 2.0, there: expected + 3.0}  # a known pose is not computed again
    assert all(torch.equal(placed_pose(spec, fresh), expected + 2.0) for spec in alike)  # type: ignore[arg-type]
    assert torch.equal(placed_pose(nowhere, fresh), expected + 3.0)  # type: ignore[arg-type]
    for other in ({"scene": THERE}, {"vehicle": "coupe"}, {"replicate": 1}):
        elsewhere = placed_pose(make_spec(**other), fresh)  # type: ignore[arg-type]
        assert elsewhere is not None and float((elsewhere - expected).abs().max()) > 0.0
        assert not torch.equal(elsewhere, expected + 2.0)


def test_tasks_that_share_a_scene_without_room_each_say_so(assets: Assets) -> None:
    own = with_own_caches(assets)
    nowhere = PlacementSpec(min_object_points=1_000_000, attempts=2)
    found = [run_task(make_spec(mode, placement=nowhere), own) for mode in ("shape", "pose")]
    assert [{row["status"] for row in result.scores} for result in found] == [{"no_placement"}] * 2
    assert "placement" in baseline_stages(found[0]) and not baseline_stages(found[1])


@pytest.mark.parametrize(
    "changes",
    [
        {"mode": "shape_pose"},
        {"lambda_": 5.0},
        {"alpha": 0.5},
        {"attack": replace(SHORT, steps=9, search="random", space="pca", naturalness=95.0)},
        {"transfer_scenes": (TransferScene(THERE, ""),)},
        {"reference_hash": "r"},
    ],
)
def test_what_belongs_to_the_search_leaves_it(changes: dict) -> None:
    assert make_spec(**changes).baseline == make_spec("pose").baseline


@pytest.mark.parametrize(
    "changes",
    [
        {"vehicle": "coupe"},
        {"scene": THERE},
        {"scene_hash": "s"},
        {"detector": "sst"},
        {"scored_by": ("centerpoint",)},
        {"accuracy_settings": {"solver": "sphere_tracing"}},
        {"replicate": 1},
        {"base_seed": 1},
        {"effects": ("fog",)},
        {"effect_settings": {"visibility_m": 50.0}},
        {"placement": PlacementSpec(max_range_m=30.0)},
        {"attack": replace(SHORT, max_shift_m=2.0)},
        {"attack": replace(SHORT, below_ground_m=0.05)},
        {"attack": replace(SHORT, detection_radius_m=4.0)},
    ],
)
def test_what_a_score_depends_on_makes_another(changes: dict) -> None:
    assert make_spec(**changes).baseline != make_spec().baseline
