"""Tasks that fail are tried again, given up on with their traceback, and never hidden."""

from __future__ import annotations

import pandas as pd
from drivers import Drivers

TASKS = 60


def test_a_failing_task_is_quarantined_and_shown(drivers: Drivers) -> None:
    code, output, _ = drivers.run("out", "runner=local", SHIFT3D_TEST_FAILS="suv/street_002/pose")
    assert code == 3
    assert f"{TASKS - 1} of {TASKS} tasks scored" in output
    assert "1 quarantined" in output and "no root for suv/street_002/pose" in output
    final = drivers.folder / "out" / "final"
    attempts = pd.read_parquet(final / "attempts.parquet")
    failed = attempts[attempts["outcome"] == "failed"]
    assert failed["attempt"].tolist() == [1, 2], "a deterministic failure is tried twice"
    assert failed["quarantined"].tolist() == [False, True]
    assert "ArithmeticError" in failed["traceback"].iloc[1] and "cheap_task.py" in failed["traceback"].iloc[1]
    auc = pd.read_parquet(final / "auc.parquet")
    suv = auc[(auc["vehicle"] == "suv") & (auc["mode"] == "pose")]
    assert (suv["tasks_scored"] == 3).all() and (suv["tasks_planned"] == 4).all()
    # The same command again: nothing is left to run, and the gap is still said.
    code, output, _ = drivers.run("out", "runner=local")
    assert code == 3 and "1 quarantined" in output


def test_a_task_that_kills_its_worker_twice_is_quarantined(drivers: Drivers) -> None:
    code, output, errors = drivers.run("out", "runner.workers=2", SHIFT3D_TEST_CRASHES="coupe/street_001/pose")
    assert code == 3, errors
    assert f"{TASKS - 1} of {TASKS} tasks scored" in output
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    crashed = attempts[attempts["outcome"] == "crashed"]
    assert crashed["quarantined"].tolist() == [False, True]
    assert crashed["task_id"].nunique() == 1


def test_a_row_that_breaks_its_schema_is_its_own_tasks_failure(drivers: Drivers) -> None:
    code, _, _ = drivers.run("out", "runner=local", SHIFT3D_TEST_BAD_ROW="coupe/street_001/pose")
    assert code == 3
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    assert attempts["quarantined"].sum() == 1
    assert "scores.score is nan" in attempts.loc[attempts["quarantined"], "error"].item()
