"""Faults of a running driver in `out`; each returns the driver's exit code, or None if the sweep must be resumed."""

from __future__ import annotations

import dataclasses
import os
import random
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from drivers import Drivers
from process_trees import descendants

TASKS = 60
TARGETS = [f"{vehicle}/street_00{scene}/pose" for vehicle in ("coupe", "suv", "convertible") for scene in range(4)]
OFTEN = ("runner.commit_seconds=0",)
IN_RAY = (*OFTEN, "runner.workers=2", "runner.batch_seconds=0.1")


@dataclasses.dataclass
class Round:
    """One disturbed sweep. random: selects moment and victim. ray: True if Ray runs the sweep."""

    drivers: Drivers
    random: random.Random
    ray: bool

    @property
    def out(self) -> Path:
        return self.drivers.folder / "out"

    @property
    def settings(self) -> tuple[str, ...]:
        return IN_RAY if self.ray else ("runner=local", *OFTEN)

    def start(self, *words: str, seconds: float = 0.05, **environment: str) -> subprocess.Popen[str]:
        return self.drivers.start("out", *self.settings, *words, SHIFT3D_TEST_SECONDS=str(seconds), **environment)

    def run(self, *words: str, alone: bool = False, **environment: str) -> tuple[int, str]:
        code, _, errors = self.drivers.run("out", *self.settings, *words, alone=alone, **environment)
        return code, errors

    def gives_up(self, *words: str, alone: bool = False, **environment: str) -> int:
        """Check that a run ends with a quarantined task. Returns its exit code."""
        code, errors = self.run(*words, alone=alone, **environment)
        assert code == 3, errors
        return code

    def succeeds(self, alone: bool = False, **environment: str) -> int:
        """Check that a run ends with nothing missing. Returns its exit code."""
        code, errors = self.run(alone=alone, **environment)
        assert code == 0, errors
        return code

    def some_commits(self) -> None:
        self.drivers.wait_for_commits("out", self.random.randint(1, 30))


def torn_segment(here: Round) -> None:
    """Kill the driver while it writes a segment: half a file under a temporary name, and one that no entry names."""
    driver = here.start()
    here.some_commits()
    driver.kill()
    driver.wait()
    segment = sorted((here.out / "data").glob("*-scores.parquet"))[-1]
    half = segment.read_bytes()[: segment.stat().st_size // 2]
    sequence, _, rest = segment.name.partition("-")
    segment.with_name(f"{int(sequence) + 1:08d}-{rest}").write_bytes(half)
    segment.with_name(f".tmp-{driver.pid}-00001000-scores.parquet").write_bytes(half)


def out_of_memory(here: Round) -> int:
    """Let a task request more memory than its process may have."""
    return here.gives_up(alone=True, SHIFT3D_TEST_HUNGRY=here.random.choice(TARGETS))


def clock_jumps(here: Round) -> int:
    """Set the wall clock back and forth by a day, and kill the driver, too."""
    driver = here.start(SHIFT3D_TEST_CLOCK=str(here.random.randint(1, 9)))
    here.some_commits()
    driver.kill()
    driver.wait()
    return here.succeeds(alone=True, SHIFT3D_TEST_CLOCK="3")


def worker_killed(here: Round) -> int:
    """Kill a worker like the kernel's out-of-memory killer. The driver goes on."""
    driver = here.start(seconds=0.1)
    here.some_commits()
    workers = descendants(driver.pid, "ray::RayWorker")
    os.kill(here.random.choice(workers), signal.SIGKILL)
    _, errors = driver.communicate(timeout=90)
    assert driver.returncode == 0, errors
    return 0


def worker_stopped(here: Round) -> int:
    """Stop a worker: it is alive, does nothing and does not answer."""
    driver = here.start("runner.task_timeout_s=1", seconds=0.1)
    here.some_commits()
    os.kill(here.random.choice(descendants(driver.pid, "ray::RayWorker")), signal.SIGSTOP)
    _, errors = driver.communicate(timeout=90)
    assert driver.returncode == 0, errors
    return 0


def driver_killed(here: Round) -> None:
    """Kill the driver twice, the second time with every process that it started."""
    for group in (False, True):
        driver = here.start(seconds=0.1)
        before = len(here.drivers.committed("out"))
        here.drivers.wait_for_commits("out", min(before + here.random.randint(1, 15), TASKS - 1))
        os.killpg(driver.pid, signal.SIGKILL) if group else driver.kill()
        driver.wait()


def raylet_killed(here: Round) -> int | None:
    """Kill Ray's own process on this machine under its driver and workers, which may finish without it."""
    driver = here.start(seconds=0.1)
    here.some_commits()
    for process in descendants(driver.pid, "raylet/raylet"):
        os.kill(process, signal.SIGKILL)
    _, errors = driver.communicate(timeout=90)
    if driver.returncode == 0:
        return 0
    assert driver.returncode == 2 and "Run the same command again: it resumes" in errors.splitlines()[-1], errors
    return None


def exception(here: Round) -> int:
    return here.gives_up(SHIFT3D_TEST_FAILS=here.random.choice(TARGETS))


def crash(here: Round) -> int:
    """Let a task end its worker at every run."""
    return here.gives_up(SHIFT3D_TEST_CRASHES=here.random.choice(TARGETS))


def hang(here: Round) -> int:
    return here.gives_up("runner.task_timeout_s=1", SHIFT3D_TEST_HANGS=here.random.choice(TARGETS))


def full_disk(here: Round) -> None:
    """Fill a small file system, then enlarge it."""
    here.out.mkdir()
    size = f"size={here.random.randint(90, 400)}k"
    command = ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(here.out)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("no permission to mount a tmpfs")
    try:
        code, errors = here.run()
        assert code == 2 and "the disk is full" in errors.splitlines()[-1], errors
        copy = here.out.with_name("copy")
        shutil.copytree(here.out, copy)
    finally:
        subprocess.run(["umount", str(here.out)], check=True)
    here.out.rmdir()
    copy.rename(here.out)


def two_drivers(here: Round) -> int:
    """Start a second driver, which stops the first."""
    first = here.start(seconds=1.0)  # long enough to be running when the second driver starts
    here.drivers.wait_for_commits("out", here.random.randint(1, 5))
    code = here.succeeds()
    _, errors = first.communicate(timeout=60)
    assert first.returncode == 4, errors
    return code


def mlflow_down(here: Round) -> int:
    """Let nobody listen at MLflow's address: the driver reports it, and the sweep is unharmed."""
    code, errors = here.run("tracking=mlflow", "tracking.uri=http://127.0.0.1:9")
    assert code == 0 and "not in MLflow" in errors, errors
    return code


# The first faults take seconds: a plain test run has one round of each of them.
FAULTS: tuple[tuple[Callable[[Round], int | None], str], ...] = (
    (torn_segment, "both"),
    (out_of_memory, "both"),
    (clock_jumps, "both"),
    (worker_killed, "ray"),
    (driver_killed, "both"),
    (raylet_killed, "ray"),
    (exception, "both"),
    (crash, "ray"),
    (hang, "ray"),
    (full_disk, "both"),
    (two_drivers, "both"),
    (mlflow_down, "both"),
    (worker_stopped, "ray"),
)
