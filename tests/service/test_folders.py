"""Two drivers, foreign folders, full disks: one clear line, and nothing half-written."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from drivers import Drivers

TASKS = 60


def test_a_second_driver_stops_the_first(drivers: Drivers, undisturbed: dict[str, bytes]) -> None:
    first = drivers.start("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.1")
    drivers.wait_for_commits("out", 2)
    code, _, second_errors = drivers.run("out", "runner=local")
    _, errors = first.communicate(timeout=30)
    assert code == 0, second_errors
    assert first.returncode == 4
    assert "another driver took this sweep over" in errors.splitlines()[-1]
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("out") == undisturbed
    listed = {
        name
        for entry in (drivers.folder / "out" / "_log").glob("*.json")
        for name in json.loads(entry.read_text())["segments"].values()
    }
    assert {path.name for path in (drivers.folder / "out" / "data").iterdir()} == listed, "an orphan segment is left"


def test_a_second_driver_stops_a_first_whose_tasks_are_long(drivers: Drivers) -> None:
    """Else the first would keep its workers, of which a cluster has few, until a task that nobody wants has ended."""
    first = drivers.start("out", "runner.workers=1", SHIFT3D_TEST_HANGS="coupe/street_000/pose")
    status = drivers.folder / "out" / "status.json"
    deadline = time.monotonic() + 90
    while not (status.exists() and json.loads(status.read_text())["running"]):
        assert time.monotonic() < deadline, "the first driver runs no task"
        time.sleep(0.1)
    code, _, second_errors = drivers.run("out", "runner=local")
    assert code == 0, second_errors
    _, errors = first.communicate(timeout=30)
    assert first.returncode == 4 and "another driver took this sweep over" in errors.splitlines()[-1]


@pytest.mark.parametrize("unmounted", [False, True], ids=["renamed", "unmounted"])
def test_a_folder_that_goes_ends_its_sweep_and_comes_back_whole(
    drivers: Drivers, undisturbed: dict[str, bytes], unmounted: bool
) -> None:
    """Else the driver makes the folder again, and hours of results are in two folders of which neither resumes."""
    out, away = drivers.folder / "out", drivers.folder / "away"
    driver = drivers.start("out", "runner=local", "runner.commit_seconds=0", SHIFT3D_TEST_SECONDS="0.5")
    drivers.wait_for_commits("out", 2)
    out.rename(away)
    if unmounted:
        out.mkdir()
    _, errors = driver.communicate(timeout=30)
    assert driver.returncode == 2
    assert f"{out}/_log: was removed, renamed or unmounted" in errors.splitlines()[-1]
    assert not list(out.iterdir()) if unmounted else not out.exists()
    if unmounted:
        out.rmdir()
    away.rename(out)
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 0, errors
    assert drivers.final("out") == undisturbed


def test_a_folder_of_another_spec_is_refused_and_left_alone(drivers: Drivers, finished: Path) -> None:
    before = {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()}
    code, _, errors = drivers.run("out", "runner=local", "attack.steps=7")
    assert code == 2
    assert "attack.steps 40, not 7" in errors and "out=DIR" in errors
    assert len(errors.strip().splitlines()) == 1
    assert before == {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()}


def test_a_folder_of_something_else_is_refused(drivers: Drivers) -> None:
    folder = drivers.folder / "out"
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 2 and "is not the output folder of a sweep" in errors
    assert [path.name for path in folder.iterdir()] == ["thesis.tex"]


def test_a_torn_segment_is_named(drivers: Drivers, finished: Path) -> None:
    segment = next((finished / "data").glob("*-scores.parquet"))
    segment.write_bytes(segment.read_bytes()[:-100])
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 2 and segment.name in errors and "cannot be read as Parquet" in errors


def test_a_missing_log_entry_is_named(drivers: Drivers, finished: Path) -> None:
    (finished / "_log" / "00000000.json").unlink()
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 2 and "00000000.json is missing" in errors


def test_file_size_limit_stops_cleanly_and_resumes(drivers: Drivers, undisturbed: dict[str, bytes]) -> None:
    """The limit is between the sizes of plan and segment: the first segment cannot be written."""
    limit = ("bash", "-c", 'ulimit -f 16; exec "$@"', "limited")
    code, _, errors = drivers.run("out", "runner=local", prefix=limit)
    assert code == 2, errors
    assert "size limit" in errors.splitlines()[-1] and ".parquet" in errors.splitlines()[-1]
    _nothing_half_written(drivers.folder / "out")
    assert drivers.run("out", "runner=local")[0] == 0
    assert drivers.final("out") == undisturbed


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A real file system of 120 kB; skips if this process may not mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=120k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mount.returncode != 0:
        pytest.skip("no permission to mount a tmpfs")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_full_disk_stops_cleanly_and_resumes(drivers: Drivers, tiny_disk: Path, undisturbed: dict[str, bytes]) -> None:
    settings = ("runner=local", "runner.commit_seconds=0")
    code, _, errors = drivers.run("disk/out", *settings)
    assert code == 2, errors
    assert "the disk is full" in errors.splitlines()[-1] and "run the same command again" in errors.splitlines()[-1]
    out = tiny_disk / "out"
    _nothing_half_written(out)
    subprocess.run(["mount", "-o", "remount,size=8m", str(tiny_disk)], check=True)
    code, _, errors = drivers.run("disk/out", "runner=local")
    assert code == 0, errors
    committed = drivers.committed("disk/out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("disk/out") == undisturbed


def _nothing_half_written(out: Path) -> None:
    names = [path.name for path in out.rglob("*") if path.is_file()]
    assert not [name for name in names if name.startswith(".tmp-")]
    for path in out.rglob("*.parquet"):
        pq.read_table(path)
    for path in (out / "_log").glob("*.json"):
        for segment in json.loads(path.read_text())["segments"].values():
            assert (out / "data" / segment).exists()


def test_unwritable_folder(drivers: Drivers) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    folder = drivers.folder / "out"
    folder.mkdir(mode=0o500)
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 2 and "no permission" in errors


def test_a_trial_says_with_its_tables_that_they_mean_nothing(drivers: Drivers) -> None:
    code, output, errors = drivers.run("out", "runner=local", "attack.steps=5")
    assert code == 0, errors
    message, table = output.index("these AUCs mean nothing"), output.index("AUC, adversarial")
    assert message < table and "For meaningful AUCs: shift3d sweep" in output
    assert "mean nothing" not in drivers.run("whole", "runner=local")[1]
