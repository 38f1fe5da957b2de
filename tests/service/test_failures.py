"""Tasks that fail are retried, quarantined with their traceback, and never hidden."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterator

import pandas as pd
import pytest
from drivers import Drivers

from shift3d.sweep.planning.folder import read_plan

TASKS = 60
DIES, DIES_ONCE, HANGS = "coupe/street_001/pose", "convertible/street_002/pose", "suv/street_002/pose"


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drivers]:
    """A finished sweep of two Ray workers: one task kills its worker, one does so the first time only, one hangs."""
    drivers = Drivers(tmp_path_factory.mktemp("disturbed"))
    settings = ("runner.workers=2", "runner.task_timeout_s=1", "runner.batch_seconds=0.5", "runner.abort_share=null")
    tasks = {"SHIFT3D_TEST_CRASHES": DIES, "SHIFT3D_TEST_CRASHES_ONCE": DIES_ONCE, "SHIFT3D_TEST_HANGS": HANGS}
    code, output, errors = drivers.run("out", *settings, **tasks, SHIFT3D_TEST_CRASHED=str(drivers.folder / "crashed"))
    assert code == 3, errors
    assert f"{TASKS - 2} of {TASKS} tasks scored" in output
    yield drivers
    drivers.kill_all()


@pytest.fixture
def attempts(disturbed: Drivers) -> pd.DataFrame:
    """Attempts, with the task's name beside its id."""
    found = pd.read_parquet(disturbed.folder / "out" / "final" / "attempts.parquet")
    specs = [task.spec for task in read_plan(disturbed.folder / "out").tasks]
    names = {spec.task_id: f"{spec.vehicle}/{spec.scene}/{spec.mode}" for spec in specs}
    return found.assign(task=found["task_id"].map(names))


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
    # The command beside the traceback shows the error again.
    with pytest.raises(ArithmeticError, match="no root for suv/street_002/pose"):
        drivers.run_here(shlex.split(command), SHIFT3D_TEST_FAILS="suv/street_002/pose")
    auc = pd.read_parquet(final / "auc.parquet")
    suv = auc[(auc["vehicle"] == "suv") & (auc["mode"] == "pose")]
    assert (suv["tasks_scored"] == 3).all() and (suv["tasks_planned"] == 4).all()
    # The same command again: nothing is left to run, and the gap is still reported.
    code, output, _ = drivers.run("out", "runner=local")
    assert code == 3 and "1 quarantined" in output


def test_a_task_that_kills_its_worker_twice_is_quarantined(attempts: pd.DataFrame) -> None:
    crashed = attempts[(attempts["outcome"] == "crashed") & (attempts["task"] != DIES_ONCE)]
    assert crashed["quarantined"].tolist() == [False, True]
    assert set(crashed["task"]) == {DIES}


def test_a_task_that_kills_its_worker_once_is_run_again(disturbed: Drivers, attempts: pd.DataFrame) -> None:
    assert (disturbed.folder / "crashed").exists()
    assert attempts.loc[attempts["task"] == DIES_ONCE, "outcome"].tolist()[-1] == "done"
    assert not attempts.loc[attempts["task"] == DIES_ONCE, "quarantined"].any()


def test_a_row_that_breaks_its_schema_is_its_own_tasks_failure(drivers: Drivers) -> None:
    code, _, _ = drivers.run("out", "runner=local", SHIFT3D_TEST_BAD_ROW="coupe/street_001/pose")
    assert code == 3
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    assert attempts["quarantined"].sum() == 1
    assert "scores.score is nan" in attempts.loc[attempts["quarantined"], "error"].item()


def test_a_task_that_hangs_is_ended_and_given_up_on_alone(attempts: pd.DataFrame) -> None:
    hung = attempts[attempts["outcome"] == "timeout"]
    abandoned = hung[hung["quarantined"]]
    assert set(abandoned["task"]) == {HANGS}
    assert set(hung["task"]) - set(attempts.loc[attempts["outcome"] == "done", "task"]) == {HANGS}
    assert "time.sleep" in abandoned["traceback"].item(), "where it hung is not shown"
    assert f"--task {abandoned['task_id'].item()}" in abandoned["traceback"].item()


def test_without_its_faults_the_disturbed_sweep_ends_as_an_undisturbed_one(
    disturbed: Drivers, undisturbed: dict[str, bytes]
) -> None:
    shutil.copytree(disturbed.folder / "out", disturbed.folder / "again")
    code, _, errors = disturbed.run("again", "runner=local", "--retry-quarantined")
    assert code == 0, errors
    committed = disturbed.committed("again")
    assert len(committed) == len(set(committed)) == TASKS
    assert disturbed.final("again") == undisturbed


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
    code, output, errors = drivers.run_here(["sweep", "status", folder])
    assert code == 0, errors
    assert "of 60 tasks done" in output and ": running" in output and "running: coupe/" in output
    driver.kill()
    driver.wait()
    assert ": dead; the command of the sweep resumes it" in drivers.run_here(["sweep", "status", folder])[1]
    assert drivers.run("out", "runner=local")[0] == 0
    output = drivers.run_here(["sweep", "status", folder])[1]
    assert "60 of 60 tasks done (100%), 0 quarantined, 0 left" in output and ": finished" in output
