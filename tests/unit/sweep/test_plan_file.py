"""plan.parquet: small, the same bytes for the same tasks, and exactly the planned tasks."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from by_hand import BOTH_LAMBDAS, catalogue

from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.sweep.planning.plan_file import plan_bytes, read_tasks, stored_effect_requests
from shift3d.task import spec as spec_module

WORDS = ["effects=auto,none,[rain,range_noise]", "effects.range_noise_m=0.02", "effects.rain_mm_h=25"]


@pytest.fixture(scope="module")
def plan() -> Plan:
    """Effects under several settings, transfers, shape and pose."""
    return make_plan(compose_sweep("default", [*WORDS, "attack.transfer_scenes=1"]), catalogue)[0]


def rewritten(content: bytes, **columns: list[object]) -> bytes:
    table = pq.read_table(pa.BufferReader(content))
    for name, values in columns.items():
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(name), pa.array(values).cast(table.schema.field(name).type))
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue().to_pybytes())


def test_there_and_back(plan: Plan) -> None:
    content = plan_bytes(plan.tasks)
    back = read_tasks(content, "plan.parquet")
    assert back == plan.tasks and list(back) == list(plan.tasks)
    assert plan_bytes(back) == content == plan_bytes(plan.tasks)
    some = plan.tasks[::3]
    assert list(read_tasks(plan_bytes(some), "plan.parquet")) == list(some)


def test_a_plan_stays_readable_and_keeps_its_ids_when_the_spec_version_is_raised(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_folder(tmp_path / "out", plan)
    before = [task.spec.task_id for task in plan.tasks]
    monkeypatch.setattr(spec_module, "SPEC_VERSION", spec_module.SPEC_VERSION + 1)
    found = read_plan(tmp_path / "out")
    assert [task.spec.task_id for task in found.tasks] == before and found.spec_hash == plan.spec_hash
    assert [task.spec for task in found.tasks] == [task.spec for task in plan.tasks]
    again = make_plan(compose_sweep("default", [*WORDS, "attack.transfer_scenes=1"]), catalogue)[0]
    assert not {task.spec.task_id for task in again.tasks} & set(before), "the raised version repeats every task"
    with pytest.raises(InputError, match="or by another version of shift3d"):
        open_folder(tmp_path / "out", again)


def test_columns_say_what_the_specs_say(plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "plan.parquet").write_bytes(plan_bytes(plan.tasks))
    frame = pd.read_parquet(tmp_path / "plan.parquet")
    assert frame["position"].tolist() == list(range(len(plan.tasks)))
    for name in ("task_id", "vehicle", "scene", "dataset", "mode", "alpha", "detector", "accuracy", "search"):
        assert frame[name].tolist() == [getattr(task.spec, name) for task in plan.tasks], name
    assert [None if pd.isna(value) else value for value in frame["lambda"]] == [t.spec.lambda_ for t in plan.tasks]
    assert [tuple(value) for value in frame["effects"]] == [task.spec.effects for task in plan.tasks]
    assert [tuple(value) for value in frame["effects_requested"]] == [task.effects_requested for task in plan.tasks]
    assert frame["assets"].tolist() == [task.assets for task in plan.tasks]
    specs = [json.loads(one) | json.loads(other) for one, other in zip(frame["template"], frame["task_scene"])]
    assert specs == [json.loads(task.spec.canonical_json()) for task in plan.tasks]


def test_a_task_takes_little_more_room_than_its_id() -> None:
    def many(config: object) -> object:
        scenes = tuple(SceneEntry(f"s{i}", "street-hdl64", f"{i:032x}", SceneFacts(f"s{i}")) for i in range(500))
        return dataclasses.replace(catalogue(config), scenes=scenes)  # type: ignore[arg-type]

    tasks = make_plan(compose_sweep("default", BOTH_LAMBDAS), many)[0].tasks  # type: ignore[arg-type]
    assert len(tasks) == 5 * 3 * 500
    assert len(plan_bytes(tasks)) < 40 * len(tasks)


@pytest.mark.parametrize("column", ["template", "task_scene", "task_id"])
def test_another_task_under_an_id_is_refused(plan: Plan, column: str) -> None:
    content = plan_bytes(plan.tasks)
    values = pq.read_table(pa.BufferReader(content))[column].to_pylist()
    other = next(value for value in values if value != values[0])
    with pytest.raises(InputError, match=r"where\.parquet: cannot be read \(an id is not its task's\)"):
        read_tasks(rewritten(content, **{column: [other, *values[1:]]}), "where.parquet")


def test_tasks_that_are_missing_are_noticed(plan: Plan, tmp_path: Path) -> None:
    open_folder(tmp_path / "out", plan)
    (tmp_path / "out" / "plan.parquet").write_bytes(plan_bytes(plan.tasks[1:]))
    with pytest.raises(InputError, match=r"spec\.yaml and plan\.parquet are not of one sweep"):
        read_plan(tmp_path / "out")


def test_a_read_plan_keeps_no_thread_that_holds_its_bytes(plan: Plan) -> None:
    """Such a thread waits for the interpreter's lock, and the program aborts if it ends in the meantime."""
    content = plan_bytes(plan.tasks)
    owners = sys.getrefcount(content)
    for _ in range(50):
        read_tasks(content, "plan.parquet")
        stored_effect_requests(content, plan.tasks)
        assert sys.getrefcount(content) == owners


def test_the_files_of_earlier_programs_are_read(plan: Plan) -> None:
    """Files of earlier programs hold every task's whole spec."""
    columns = {
        "task_id": plan.tasks.ids,
        "spec": [task.spec.canonical_json() for task in plan.tasks],
        "assets": pa.array([task.assets for task in plan.tasks], type=pa.int32()),
        "effects_asked": [list(task.effects_requested) for task in plan.tasks],
    }
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), sink)
    assert read_tasks(sink.getvalue().to_pybytes(), "plan.parquet") == plan.tasks
