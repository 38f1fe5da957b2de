"""Objects that could not be verified are left out of a fine-tuning; an unfinished verification is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import valid_sweeps

from shift3d.errors import InputError
from shift3d.finetuning.objects import stable_objects
from shift3d.settings.compose import compose_sweep
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import table_from_rows, write_table
from shift3d.sweep.follow_up import solved_tasks
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.sweep.results.final import VERIFICATION, write_final


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    """Plan of a finished sweep in tmp_path: a suv on two training streets."""
    train = {"kind": "street", "split": "train"}
    composed = compose_sweep("smoke", ["vehicle=suv", "mode=shape"])
    plan, _ = make_plan(composed, lambda own: dataclasses.replace(valid_sweeps.catalogue(own), scene_arguments=train))
    open_folder(tmp_path, plan)
    log = CommitLog(tmp_path, plan.spec_hash)
    for task in plan.tasks:
        rows = {name: valid_sweeps.rows(name, task) for name in ("scores", "solutions", "timings", "attempts")}
        rows["scores"] = [row | {"stable": None, "score_reference": None} for row in rows["scores"]]
        log.commit((task.spec.task_id,), (), {name: table_from_rows(name, own) for name, own in rows.items()})
    write_final(tmp_path, plan, log.entries)
    return plan


@pytest.mark.parametrize("quarantined", [True, False])
def test_a_task_whose_verification_failed_is_left_out(tmp_path: Path, plan: Plan, quarantined: bool) -> None:
    first, second = plan.tasks.ids.to_pylist()
    folder, solved = tmp_path / VERIFICATION, solved_tasks(tmp_path)
    open_folder(folder, solved)
    log = CommitLog(folder, solved.spec_hash)
    log.commit((first,), (second,) if quarantined else (), {})
    found = table_from_rows(VERIFICATION, valid_sweeps.rows(VERIFICATION, plan.tasks[0]))
    write_table(folder / "final" / f"{VERIFICATION}.parquet", found)
    write_final(tmp_path, read_plan(tmp_path), read_log(tmp_path))
    if not quarantined:
        with pytest.raises(InputError, match=r"not verified.*shift3d verify"):
            stable_objects(tmp_path, "pointpillars", "p", "adversarial")
        return
    objects = stable_objects(tmp_path, "pointpillars", "p", "adversarial")
    assert [row.spec.task_id for row in objects.objects] == [first] and objects.left_out == {"unverified": 1}
