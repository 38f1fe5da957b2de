"""What happens to a sweep in the middle of its work: each fault starts a driver in `out`, disturbs it for real, and
returns when that driver has ended: with its exit code where it came to its end, None where it has to be resumed."""

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
    """One sweep that is disturbed. random: decides about the moment and the victim. ray: whether Ray runs it."""

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
        """A run that ends with a quarantined task."""
        code, errors = self.run(*words, alone=alone, **environment)
        assert code == 3, errors
        return code

    def succeeds(self, alone: bool = False, **environment: str) -> int:
        """A run that ends with nothing missing."""
        code, errors = self.run(alone=alone, **environment)
        assert code == 0, errors
        return code

    def some_commits(self) -> None:
        self.drivers.wait_for_commits("out", self.random.randint(1, 30))


def torn_segment(here: Round) -> None:
    """Killed in the middle of writing a segment: half a file under a temporary name, and one that no entry names."""
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
    """A task asks for more than its process may have."""
    return here.gives_up(alone=True, SHIFT3D_TEST_HUNGRY=here.random.choice(TARGETS))


def clock_jumps(here: Round) -> int:
    """The wall clock goes back and forth by a day, and the driver is killed, too."""
    driver = here.start(SHIFT3D_TEST_CLOCK=str(here.random.randint(1, 9)))
    here.some_commits()
    driver.kill()
    driver.wait()
    return here.succeeds(alone=True, SHIFT3D_TEST_CLOCK="3")


def worker_killed(here: Round) -> int:
    """As the kernel's out-of-memory killer does it. The driver goes on."""
    driver = here.start(seconds=0.1)
    here.some_commits()
    workers = descendants(driver.pid, "ray::RayWorker")
    os.kill(here.random.choice(workers), signal.SIGKILL)
    _, errors = driver.communicate(timeout=90)
    assert driver.returncode == 0, errors
    return 0


def worker_stopped(here: Round) -> int:
    """A worker that is alive and does nothing, not even answer."""
    driver = here.start("runner.task_timeout_s=1", seconds=0.1)
    here.some_commits()
    os.kill(here.random.choice(descendants(driver.pid, "ray::RayWorker")), signal.SIGSTOP)
    _, errors = driver.communicate(timeout=90)
    assert driver.returncode == 0, errors
    return 0


def driver_killed(here: Round) -> None:
    """Twice, the second time with whatever it started."""
    for group in (False, True):
        driver = here.start(seconds=0.1)
        before = len(here.drivers.committed("out"))
        here.drivers.wait_for_commits("out", min(before + here.random.randint(1, 15), TASKS - 1))
        os.killpg(driver.pid, signal.SIGKILL) if group else driver.kill()
        driver.wait()


def raylet_killed(here: Round) -> int | None:
    """Ray's own process on this machine goes away under its driver and workers. They may come to the end without it."""
    driver = here.start(seconds=0.1)
    here.some_commits()
    for process in descendants(driver.pid, "raylet/raylet"):
        os.kill(process, signal.SIGKILL)
    driver.communicate(timeout=90)
    return None if driver.returncode else 0


def exception(here: Round) -> int:
    return here.gives_up(SHIFT3D_TEST_FAILS=here.random.choice(TARGETS))


def crash(here: Round) -> int:
    """A task that ends its worker whenever it is run."""
    return here.gives_up(SHIFT3D_TEST_CRASHES=here.random.choice(TARGETS))


def hang(here: Round) -> int:
    return here.gives_up("runner.task_timeout_s=1", SHIFT3D_TEST_HANGS=here.random.choice(TARGETS))


def full_disk(here: Round) -> None:
    """A small file system that fills up, and is then made larger."""
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
    """The second one stops the first."""
    first = here.start(seconds=1.0)  # long enough to be still at it when the second one comes
    here.drivers.wait_for_commits("out", here.random.randint(1, 5))
    code = here.succeeds()
    _, errors = first.communicate(timeout=60)
    assert first.returncode == 4, errors
    return code


def mlflow_down(here: Round) -> int:
    """Nobody listens where MLflow should be: said, and no harm to the sweep."""
    code, errors = here.run("tracking=mlflow", "tracking.uri=http://127.0.0.1:9")
    assert code == 0 and "not in MLflow" in errors, errors
    return code


# The first ones take seconds: a plain test run has one round of each of these.
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
