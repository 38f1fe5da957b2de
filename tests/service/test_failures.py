"""Tasks that fail are tried again, given up on with their traceback, and never hidden."""

from __future__ import annotations

import shlex

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
    command = failed["traceback"].iloc[1].splitlines()[-1].removeprefix("reproduce: shift3d ")
    code, _, errors = drivers.command(*shlex.split(command), SHIFT3D_TEST_FAILS="suv/street_002/pose")
    assert code == 1 and "no root for suv/street_002/pose" in errors, "the command beside the traceback shows it again"
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


def test_a_task_that_hangs_is_ended_and_given_up_on_alone(drivers: Drivers) -> None:
    settings = ("runner.workers=2", "runner.task_timeout_s=1", "runner.batch_seconds=0.5")
    code, _, errors = drivers.run("out", *settings, SHIFT3D_TEST_HANGS="suv/street_002/pose")
    assert code == 3, errors
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    hung = attempts[attempts["outcome"] == "timeout"]
    given_up = hung[hung["quarantined"]]
    assert given_up["task_id"].nunique() == 1 and set(given_up["task_id"]) == set(hung["task_id"]) - set(
        attempts.loc[attempts["outcome"] == "done", "task_id"]
    )
    assert "time.sleep" in given_up["traceback"].item(), "where it hung is not shown"
    assert f"--task {given_up['task_id'].item()}" in given_up["traceback"].item()


def test_what_was_given_up_on_is_run_again_when_asked(drivers: Drivers, undisturbed: dict[str, bytes]) -> None:
    assert drivers.run("out", "runner=local", SHIFT3D_TEST_FAILS="suv/street_002/pose")[0] == 3
    assert drivers.run("out", "runner=local")[0] == 3, "without being asked nothing is run again"
    code, output, errors = drivers.run("out", "runner=local", "--retry-quarantined")
    assert code == 0, errors
    assert "60 of 60 tasks scored" in output
    assert drivers.final("out") == undisturbed
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    again = attempts[attempts["task_id"].isin(attempts.loc[attempts["quarantined"], "task_id"])]
    assert again["attempt"].tolist() == [1, 2, 3] and again["outcome"].tolist() == ["failed", "failed", "done"]


def test_a_sweep_whose_first_tasks_fail_alike_stops_and_says_what_to_do(drivers: Drivers) -> None:
    code, _, errors = drivers.run("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_FAILS="coupe/")
    assert code == 5, errors
    assert "the first 5 tasks failed alike: ArithmeticError: no root for coupe" in errors.splitlines()[-1]
    assert "--retry-quarantined" in errors.splitlines()[-1]
    code, output, errors = drivers.run("out", "runner=local", "--retry-quarantined")
    assert code == 0 and "60 of 60 tasks scored" in output, errors


def test_the_status_says_how_it_goes(drivers: Drivers) -> None:
    driver = drivers.start("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.2")
    drivers.wait_for_commits("out", 3)
    folder = str(drivers.folder / "out")
    code, output, errors = drivers.command("sweep", "status", folder)
    assert code == 0, errors
    assert "of 60 tasks done" in output and ": running" in output and "runs now: coupe/" in output
    driver.kill()
    driver.wait()
    assert ": dead; the same command resumes" in drivers.command("sweep", "status", folder)[1]
    assert drivers.run("out", "runner=local")[0] == 0
    output = drivers.command("sweep", "status", folder)[1]
    assert "60 of 60 tasks done (100%), 0 quarantined, 0 left" in output and ": finished" in output
