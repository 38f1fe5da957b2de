"""Naturalness of a task's shapes: measured, bounded, and no part of a task that does not request it."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh
from short_tasks import KNOWN, SHORT, WIDE, by_method, make_spec

from shift3d.errors import InputError
from shift3d.naturalness.measure import NaturalnessMeasure
from shift3d.naturalness.sizes import sizes_of
from shift3d.naturalness.sources import reference_source, source_hash
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.store.tables import table_from_rows
from shift3d.task.assets import Assets
from shift3d.task.exchange import TaskResult
from shift3d.task.rows import shape_columns
from shift3d.task.run import run_task
from shift3d.task.spec import AttackSpec, TaskSpec

MEASURED = {"surface_distance_cm", "surface_distance_p95_cm", "naturalness_percentile", "natural"}
FAR = AttackSpec(steps=2, noise_replicates=0)


def test_nothing_is_measured_without_a_reference_set(shape: TaskResult, pose: TaskResult) -> None:
    assert shape.shapes == pose.shapes == []
    assert not any(MEASURED & row.keys() for row in shape.scores + pose.scores)


@pytest.fixture(scope="module")
def measured(
    referenced: Assets, wide_reference: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Assets, str]]:
    """Assets with a reference set, and its hash."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(shutil.copytree(wide_reference, tmp_path_factory.mktemp("own") / "cache")))
        yield referenced, source_hash(reference_source(WIDE))


def far_spec(measured: tuple[Assets, str]) -> TaskSpec:
    """The spec of a search that takes long steps."""
    return make_spec(reference_hash=measured[1], alpha=0.1, attack=FAR)


@pytest.fixture(scope="module")
def free(measured: tuple[Assets, str]) -> TaskResult:
    """A search that no budget holds back."""
    return run_task(far_spec(measured), measured[0])


def test_every_shape_and_baseline_says_how_natural_it_is(measured: tuple[Assets, str], free: TaskResult) -> None:
    with_values = [row for row in free.scores if row.keys() >= MEASURED]
    assert [row["method"] for row in with_values] == ["baseline", "random", "adversarial"]
    assert [row["method"] for row in free.shapes] == ["baseline", "random", "adversarial"]
    for scored, looked_at in zip(with_values, free.shapes):
        assert scored["surface_distance_cm"] == (looked_at["to_member_cm"] + looked_at["from_member_cm"]) / 2
        assert 0.0 < scored["surface_distance_cm"] < scored["surface_distance_p95_cm"] < 40.0
        assert scored["natural"] == (scored["naturalness_percentile"] <= 95.0 and not looked_at["out_of_range"])
    own = free.shapes[0]
    assert own["nearest_member"].startswith("suv") and own["largest_piece"] > 0.97 and own["out_of_range"] == []
    sizes = [own[name] for name in ("length_m", "width_m", "height_m")]
    assert sizes == pytest.approx(measured[0].vehicle(make_spec()).size_m, abs=0.02)
    assert table_from_rows("shapes", [row | KNOWN for row in free.shapes]).num_rows == 3


def test_a_shape_without_a_middle_has_no_clearance_and_its_row_is_written() -> None:
    front, rear = trimesh.creation.box((0.5, 0.5, 0.5)), trimesh.creation.box((0.5, 0.5, 0.5))
    rear.apply_translation((-4.0, 1.5, 0.2))
    surface = surface_of_mesh(trimesh.util.concatenate([front, rear]))
    found = NaturalnessMeasure(None, sizes_of(surface), 100.0, 0.5)
    assert "clearance_m" in found.out_of_range
    row = KNOWN | {"method": "adversarial", "replicate": 0} | shape_columns(found)
    written = table_from_rows("shapes", [row])
    assert written["clearance_m"].to_pylist() == [None] and written["length_m"].to_pylist() == [4.5]


def test_a_pose_has_its_baselines_shape(measured: tuple[Assets, str]) -> None:
    found = run_task(
        make_spec("pose", reference_hash=measured[1], attack=dataclasses.replace(FAR, steps=1)), measured[0]
    )
    assert [row["method"] for row in found.shapes] == ["baseline"]
    assert len({row["surface_distance_cm"] for row in found.scores if row["status"] == "ok"}) == 1


def test_a_search_with_a_budget_ends_at_a_natural_shape(measured: tuple[Assets, str], free: TaskResult) -> None:
    ends = [by_method(free, method)[0]["naturalness_percentile"] for method in ("baseline", "adversarial")]
    budget = sum(ends) / 2
    assert ends[0] < budget
    spec = far_spec(measured)
    bounded = dataclasses.replace(spec, attack=dataclasses.replace(FAR, random_replicates=0, naturalness=budget))
    (within,) = by_method(run_task(bounded, measured[0]), "adversarial")
    assert within["naturalness_percentile"] <= budget < ends[1] and within["latent_distance"] > 0.0
    assert bounded.search == f"descent_within{budget:g}" and bounded.task_id != spec.task_id


def test_a_budget_needs_a_reference_set_and_a_vehicle_within(assets: Assets, measured: tuple[Assets, str]) -> None:
    bounded = dataclasses.replace(SHORT, naturalness=1e-6)
    with pytest.raises(InputError, match=r"measures no naturalness.*naturalness=wide"):
        run_task(make_spec(attack=bounded), assets)
    with pytest.raises(InputError, match=r"vehicle lies beyond the budget.*larger attack\.naturalness"):
        run_task(make_spec(attack=bounded, reference_hash=measured[1]), measured[0])


def test_another_reference_set_than_was_planned_is_refused(measured: tuple[Assets, str]) -> None:
    with pytest.raises(InputError, match="changed after the sweep was planned") as failure:
        run_task(make_spec(reference_hash="another"), measured[0])
    assert "reference set" in failure.value.where


def test_a_task_that_measures_none_keeps_the_id_of_an_older_program() -> None:
    assert "reference_hash" not in make_spec().to_dict()
    assert TaskSpec.from_dict(make_spec().to_dict()) == make_spec()
    other = make_spec(reference_hash="a" * 32)
    assert TaskSpec.from_dict(other.to_dict()) == other and other.task_id != make_spec().task_id
