"""A driver that is killed loses no committed result, and repeats none."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from drivers import Drivers

TASKS = 60


def test_killed_local_driver_resumes_to_the_same_bytes(drivers: Drivers, undisturbed: dict[str, bytes]) -> None:
    for kills in (1, 2):
        driver = drivers.start("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.03")
        drivers.wait_for_commits("out", 20 * kills)
        driver.send_signal(signal.SIGKILL)
        driver.wait()
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 0, errors
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("out") == undisturbed


def test_interrupt_finishes_what_is_in_flight_and_says_how_to_resume(
    drivers: Drivers, undisturbed: dict[str, bytes]
) -> None:
    driver = drivers.start("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.05")
    drivers.wait_for_commits("out", 3)
    driver.send_signal(signal.SIGINT)
    _, errors = driver.communicate(timeout=30)
    assert driver.returncode == 130
    done = len(drivers.committed("out"))
    assert f"{done} of {TASKS} tasks done" in errors
    assert "resumes: shift3d sweep default" in errors
    assert not (drivers.folder / "out" / "final").exists()
    assert drivers.run("out", "runner=local")[0] == 0
    assert drivers.final("out") == undisturbed


def test_an_interrupted_second_try_says_how_it_goes_on(drivers: Drivers) -> None:
    first = ("runner=local", "runner.abort_share=null")
    assert drivers.run("out", *first, SHIFT3D_TEST_FAILS="suv/street_002/")[0] == 3
    again = ("runner=local", "runner.commit_seconds=0", "--retry-quarantined")
    driver = drivers.start("out", *again, SHIFT3D_TEST_SECONDS="0.8")
    done = len(drivers.committed("out"))
    drivers.wait_for_commits("out", done + 1)
    driver.send_signal(signal.SIGINT)
    _, errors = driver.communicate(timeout=60)
    assert driver.returncode == 130, errors
    done = len(drivers.committed("out"))
    assert TASKS - done > 0 and f"{TASKS - done} left" in errors
    assert errors.rstrip().endswith("--retry-quarantined")
    assert drivers.run("out", "runner=local", "--retry-quarantined")[0] == 0
    assert len(drivers.committed("out")) == TASKS


def test_a_signal_to_the_whole_job_lets_its_workers_finish_and_a_killed_driver_resumes_with_others(
    drivers: Drivers, undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    """``timeout``, Slurm and systemd end a job like this: every process gets SIGTERM, those of Ray too."""
    first, last = tmp_path / "first", tmp_path / "last"
    settings = ("runner.commit_seconds=0", "runner.batch_seconds=0.1")
    driver = drivers.start(
        "out", "runner.workers=2", *settings, SHIFT3D_TEST_SECONDS="0.5", SHIFT3D_TEST_JOURNAL=str(first)
    )
    drivers.wait_for_commits("out", 6)
    os.killpg(driver.pid, signal.SIGTERM)
    _, errors = driver.communicate(timeout=60)
    assert driver.returncode == 130, errors
    committed = drivers.committed("out")
    assert len(committed) < TASKS and sorted(committed) == sorted(first.read_text().split())
    assert f"{len(committed)} of {TASKS} tasks done" in errors

    driver = drivers.start("out", "runner.workers=1", *settings, SHIFT3D_TEST_SECONDS="0.1")
    drivers.wait_for_commits("out", len(committed) + 4)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    before = set(drivers.committed("out"))
    assert len(committed) + 4 <= len(before) < TASKS
    code, _, errors = drivers.run("out", "runner=local", SHIFT3D_TEST_JOURNAL=str(last))
    assert code == 0, errors
    ran = last.read_text().split()
    assert len(ran) == len(set(ran)) == TASKS - len(before)
    assert before.isdisjoint(ran), "a committed task was run again"
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("out") == undisturbed


def test_second_interrupt_drops_what_is_in_flight(drivers: Drivers) -> None:
    driver = drivers.start("out", "runner=local", SHIFT3D_TEST_SECONDS="30")
    deadline = time.monotonic() + 30
    while not list((drivers.folder / "out" / "_log").glob("[0-9]*.json")):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.5)
    for _ in range(2):
        os.kill(driver.pid, signal.SIGINT)
        time.sleep(0.3)  # two signals at once count as one
    driver.communicate(timeout=10)
    assert driver.returncode == 130
