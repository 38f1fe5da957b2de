"""Rows taken over from another sweep carry this sweep's name; a follow-up's folder has none to take over."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import valid_sweeps
from by_hand import score_row

from shift3d.errors import InputError
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import attempt_row
from shift3d.sweep.follow_up import solved_tasks
from shift3d.sweep.planning.folder import open_folder
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.results.final import write_final
from shift3d.sweep.results.reuse import copy_finished_tasks


def test_the_other_sweep_may_have_another_name_and_order(tmp_path: Path, suv_plan: Plan) -> None:
    other = dataclasses.replace(suv_plan, sweep="other", tasks=suv_plan.tasks[::-2])
    open_folder(tmp_path / "other", other)
    log = CommitLog(tmp_path / "other", other.spec_hash)
    for task in other.tasks:
        attempts = table_from_rows("attempts", [attempt_row(task.spec.task_id, 1, "done", 0.0, 1.0)])
        scores = table_from_rows("scores", [score_row(task, "other", "baseline", 0.8, 1.0)])
        log.commit((task.spec.task_id,), (), {"scores": scores, "attempts": attempts})
    own = CommitLog(tmp_path / "own", suv_plan.spec_hash)
    assert copy_finished_tasks(own, suv_plan, tmp_path / "other") == 3
    assert copy_finished_tasks(own, suv_plan, tmp_path / "other") == 0
    assert own.done() == set(other.tasks.ids.to_pylist())
    final = write_final(tmp_path / "own", suv_plan, own.entries)
    assert final.frame("scores")["sweep"].tolist() == ["default"] * 3
    assert final.frame("scores")["task_id"].tolist() == suv_plan.tasks.ids.to_pylist()[1::2]
    assert final.frame("attempts")["task_id"].tolist() == suv_plan.tasks.ids.to_pylist()[1::2]


def test_a_follow_up_whose_tasks_have_the_ids_of_the_sweeps_is_neither_resumed_nor_reused(tmp_path: Path) -> None:
    folder, plan = tmp_path / "sweep", valid_sweeps.plan()
    valid_sweeps.write_sweep(folder)
    write_final(folder, plan, read_log(folder))
    follow_up = solved_tasks(folder)
    for _ in range(2):  # the follow-up itself resumes
        open_folder(folder / "patterns", follow_up)
    log = CommitLog(folder / "patterns", follow_up.spec_hash)
    log.commit(tuple(follow_up.tasks.ids.to_pylist()), (), {})
    own = CommitLog(tmp_path / "own", plan.spec_hash)
    with pytest.raises(InputError, match=r"patterns: holds a follow-up of sweep smoke.*Give the folder of the sweep"):
        copy_finished_tasks(own, plan, folder / "patterns")
    with pytest.raises(InputError, match="patterns: holds a follow-up of sweep smoke"):
        open_folder(folder / "patterns", plan)
    assert not own.done()
