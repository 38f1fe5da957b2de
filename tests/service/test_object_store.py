"""Sweeps with their output in a bucket: killed, resumed, and the same bytes as in a folder."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from bucket_server import ENVIRONMENT, bucket_server, new_bucket
from drivers import DETERMINISTIC, DRIVER, QUICK, Drivers
from faulty_proxy import faulty_proxy

from shift3d.store.buckets import object_store
from shift3d.store.location import Location
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import read_table
from shift3d.sweep.results import commit

TASKS = 60


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with bucket_server() as endpoint:
        yield endpoint


@pytest.fixture
def out(server: str, monkeypatch: pytest.MonkeyPatch) -> Location:
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server}.items():
        monkeypatch.setenv(name, value)
    return as_location(f"s3://{new_bucket(server)}/runs/sweep")


def committed(out: Location) -> list[str]:
    return [task for entry in read_log(out) for task in entry.done]


def final(out: Location) -> dict[str, bytes]:
    return {name: (out / "final" / f"{name}.parquet").read_bytes() for name in DETERMINISTIC}


def start(drivers: Drivers, out: Location, *words: str, **environment: str) -> subprocess.Popen[str]:
    """Start a driver with this process's environment, in which the server's address is set."""
    return drivers._start([sys.executable, str(DRIVER), "sweep", "default", *QUICK, *words, f"out={out}"], environment)


def run(drivers: Drivers, out: Location, *words: str, **environment: str) -> None:
    """Run a driver in this process, which must succeed."""
    code, _, errors = drivers.run_here(["sweep", "default", *QUICK, *words, f"out={out}"], **environment)
    assert code == 0, errors


def wait_for_commits(out: Location, tasks: int) -> None:
    deadline = time.monotonic() + 60
    while len(committed(out)) < tasks:
        assert time.monotonic() < deadline, "the sweep commits nothing"
        time.sleep(0.05)


def test_killed_drivers_resume_in_the_bucket(drivers: Drivers, undisturbed: dict[str, bytes], out: Location) -> None:
    driver = start(drivers, out, "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.03")
    wait_for_commits(out, 10)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    assert 10 <= len(committed(out)) < TASKS
    run(drivers, out, "runner=local")
    assert sorted(committed(out)) == sorted(set(committed(out))) and len(committed(out)) == TASKS
    assert final(out) == undisturbed
    assert not list(drivers.folder.iterdir()), "nothing is written beside the bucket"


def test_ray_workers_need_no_common_folder_and_a_task_that_does_not_come_back_counts_once(
    drivers: Drivers, undisturbed: dict[str, bytes], out: Location, tmp_path: Path
) -> None:
    """The last task sleeps for an hour in its first run. The driver must not wait for that."""
    slept = tmp_path / "slept"
    hangs = {"SHIFT3D_TEST_HANGS": "beach_wagon/street_003/pose", "SHIFT3D_TEST_HANG_ONCE": str(slept)}
    run(drivers, out, "runner.workers=2", "runner.batch_seconds=0.05", **hangs)
    assert slept.exists()
    assert len(committed(out)) == len(set(committed(out))) == TASKS
    assert final(out) == undisturbed
    attempts = read_table(out / "final" / "attempts.parquet", "attempts").to_pandas()
    assert (attempts["outcome"] == "done").all() and attempts["attempt"].max() == 2


def test_a_second_driver_stops_the_first_in_the_bucket(
    drivers: Drivers, undisturbed: dict[str, bytes], out: Location
) -> None:
    first = start(drivers, out, "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.1")
    wait_for_commits(out, 2)
    run(drivers, out, "runner=local")
    _, errors = first.communicate(timeout=30)
    assert first.returncode == 4 and "another driver took this sweep over" in errors
    assert len(committed(out)) == len(set(committed(out))) == TASKS
    assert final(out) == undisturbed


def test_a_bucket_that_is_silent_for_a_while_ends_no_sweep(
    drivers: Drivers, undisturbed: dict[str, bytes], server: str, out: Location, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Longer than one request is tried, and while tasks end."""
    monkeypatch.setitem(object_store._RETRY, "max_retries", 1)
    monkeypatch.setattr(commit, "_RETRY_S", 0.5)
    with faulty_proxy(server) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.address)

        def refuse() -> None:
            while len(proxy.requests) < 60:
                time.sleep(0.05)
            proxy.refusal = (503, "SlowDown")
            time.sleep(3.0)
            proxy.refusal = None

        refusing = threading.Thread(target=refuse)
        refusing.start()
        words = ["sweep", "default", *QUICK, "runner=local", "runner.commit_seconds=0", f"out={out}"]
        code, _, errors = drivers.run_here(words, SHIFT3D_TEST_SECONDS="0.1")
        refusing.join()
        assert code == 0, errors
        assert "the store does not answer" in errors and "answers again" in errors
        assert len(committed(out)) == len(set(committed(out))) == TASKS
        assert final(out) == undisturbed


def test_the_commands_read_the_bucket(
    drivers: Drivers, out: Location, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from shift3d.analysis.mlflow.sweep import SweepRecord, mirror
    from shift3d.cli.main import main
    from shift3d.sweep.planning.folder import read_plan

    run(drivers, out, "runner=local")
    plan = read_plan(out)
    assert len(plan.tasks) == TASKS
    assert main(["sweep", "status", str(out)]) == 0
    assert "60 of 60 tasks done" in capsys.readouterr().out
    task = plan.tasks[0].spec.task_id
    assert main(["export", str(out), f"task={task}", "method=wish", f"to={tmp_path}"]) == 2
    assert "solutions.parquet" in capsys.readouterr().err
    assert main(["report", f"{out}/nowhere"]) == 2
    assert "is not the output folder of a sweep" in capsys.readouterr().err
    auc, curves = (read_table(out / "final" / f"{name}.parquet", name).to_pandas() for name in ("auc", "curves"))
    record = SweepRecord("default", plan.spec_hash, out, {}, auc, curves, {"tasks_done": TASKS})
    store = tmp_path / "mlflow"
    store.mkdir()
    with contextlib.chdir(store):
        assert mirror(record, f"sqlite:///{store}/mlflow.db", "bucket") is None
    assert {path.name for path in store.rglob("scores.parquet")} == {"scores.parquet"}
    assert json.loads(next(store.rglob("env.json")).read_text())["shift3d"]


def test_a_missing_bucket_is_one_clear_line(drivers: Drivers, out: Location) -> None:
    words = ["sweep", "default", *QUICK, "runner=local", "out=s3://nobody-made-this/sweep"]
    code, _, errors = drivers.run_here(words)
    assert code == 2
    assert "s3://nobody-made-this/sweep" in errors and "there is no such bucket" in errors
    assert len(errors.strip().splitlines()) == 1
