"""Status of a sweep for another shell: also after a resumption or compaction, and at once."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import valid_sweeps

from shift3d.errors import InputError
from shift3d.settings.schema.config import LocalRunnerConfig
from shift3d.store.housekeeping import compact
from shift3d.store.log import CommitLog, TakenOverError
from shift3d.sweep.drive import run_sweep
from shift3d.sweep.planning.folder import read_environment
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.status import StatusWriter, read_status, status_lines

LOCAL = LocalRunnerConfig(kind="local", commit_seconds=0.0, abort_after=None, abort_share=None)
HASH = valid_sweeps.plan().spec_hash


def not_wanted(*_: object) -> object:
    raise AssertionError("nothing is left to run")


def unloadable(*_: object) -> object:
    raise InputError("no weights")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A finished sweep whose driver reported its end."""
    valid_sweeps.write_sweep(tmp_path / "sweep")
    StatusWriter(CommitLog(tmp_path / "sweep", HASH), 2).write([], 1, "finished")
    return tmp_path / "sweep"


def message(folder: Path) -> str:
    return status_lines(read_status(folder))


def test_a_finished_sweep(folder: Path) -> None:
    assert "2 of 2 tasks done (100%), 0 quarantined, 0 left, 2 commits" in message(folder) and ": finished" in message(
        folder
    )


def test_a_finished_sweep_that_is_run_again_is_finished(folder: Path) -> None:
    run_sweep(valid_sweeps.plan(), LOCAL, TaskKind(not_wanted, not_wanted, not_wanted), folder)  # type: ignore[arg-type]
    assert ": finished" in message(folder) and "2 commits" in message(folder)
    assert f"driver {CommitLog(folder, HASH).entries[-2].driver}" in message(folder), "the last one says it"


def test_a_finished_sweep_whose_last_driver_said_nothing_is_finished(folder: Path) -> None:
    CommitLog(folder, HASH)
    assert ": finished" in message(folder) and "taken over" not in message(folder)


def test_a_compacted_sweep_is_finished_and_says_what_became_of_its_commits(folder: Path) -> None:
    compact(folder)
    assert ": finished" in message(folder) and message(folder).splitlines()[0].endswith("0 left, log compacted")


def unfinished(folder: Path, state: str) -> CommitLog:
    """Return a sweep with one task done, whose driver reported a state and is gone."""
    valid_sweeps.write_sweep(folder)
    last = max((folder / "_log").glob("*.json"))
    last.unlink()
    log = CommitLog(folder, HASH)
    StatusWriter(log, 2).write([], 1, state)  # type: ignore[arg-type]
    return log


def test_the_time_left_covers_quarantined_tasks_that_run_again(tmp_path: Path) -> None:
    task = valid_sweeps.plan().tasks[1].spec.task_id
    log = unfinished(tmp_path, "interrupted")
    log.commit((), (task,), {})
    writer = StatusWriter(log, 2)
    writer.finished(1, 0.0)
    time.sleep(0.1)
    writer.write([], 1)
    assert "1 quarantined, 0 left" in message(tmp_path)
    speed = next(line for line in message(tmp_path).splitlines() if "tasks a second" in line)
    rate, about = float(speed.split()[0]), speed.partition("about ")[2].split()
    assert float(about[0]) * {"ms": 1e-3, "s": 1.0}[about[1]] == pytest.approx(1 / rate, rel=0.01), "one of two waits"


def test_an_unfinished_sweep_that_was_compacted_is_what_its_driver_said(tmp_path: Path) -> None:
    unfinished(tmp_path, "interrupted")
    compact(tmp_path)
    assert "1 left, log compacted" in message(tmp_path) and ": interrupted" in message(tmp_path)


def test_another_driver_takes_an_unfinished_sweep_over(tmp_path: Path) -> None:
    unfinished(tmp_path, "running")
    other = CommitLog(tmp_path, HASH)
    assert f"taken over by driver {other.driver}" in message(tmp_path)


def test_a_driver_that_was_superseded_stops_before_its_next_commit_and_leaves_the_status_alone(tmp_path: Path) -> None:
    valid_sweeps.write_sweep(tmp_path)
    first = CommitLog(tmp_path, HASH)
    earlier = StatusWriter(first, 2)
    other = CommitLog(tmp_path, HASH)
    StatusWriter(other, 2).write([], 1)
    before = (tmp_path / "status.json").read_bytes()
    with pytest.raises(TakenOverError, match=f"driver {other.driver} wrote entry"):
        earlier.write([], 1)
    assert (tmp_path / "status.json").read_bytes() == before


def test_a_driver_speaks_before_its_first_task(tmp_path: Path) -> None:
    unfinished(tmp_path, "interrupted")
    with pytest.raises(InputError, match="no weights"):
        run_sweep(valid_sweeps.plan(), LOCAL, TaskKind(not_wanted, unloadable, not_wanted), tmp_path)  # type: ignore[arg-type]
    assert ": stopped" in message(tmp_path)


@pytest.mark.parametrize("begun", ["AVX0 without bfloat16", None])
def test_a_sweep_that_another_processor_began_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], begun: str | None
) -> None:
    unfinished(tmp_path, "interrupted")
    environment = read_environment(tmp_path)
    if begun:
        (tmp_path / "env.json").write_text(json.dumps(environment | {"instructions": begun}))
    with pytest.raises(InputError, match="no weights"):
        run_sweep(valid_sweeps.plan(), LOCAL, TaskKind(not_wanted, unloadable, not_wanted), tmp_path)  # type: ignore[arg-type]
    printed = capsys.readouterr().err
    assert ("the one that began the sweep with AVX0 without bfloat16" in printed) == bool(begun)
    assert ("this processor computes with" in printed) == bool(begun)


def test_a_damaged_environment_is_named_and_no_driver_claims_to_start(tmp_path: Path) -> None:
    unfinished(tmp_path, "interrupted")
    (tmp_path / "env.json").write_text("[1")
    with pytest.raises(InputError, match=r"env\.json: cannot be read"):
        run_sweep(valid_sweeps.plan(), LOCAL, TaskKind(not_wanted, not_wanted, not_wanted), tmp_path)  # type: ignore[arg-type]
    assert "starting" not in message(tmp_path)


def test_a_process_that_has_the_number_of_a_dead_driver_is_not_the_driver(tmp_path: Path) -> None:
    unfinished(tmp_path, "running")
    assert ": running" in message(tmp_path), "this process, which is alive"
    status = tmp_path / "status.json"
    status_values = json.loads(status.read_text())
    status.write_text(json.dumps(status_values | {"pid": 1}))
    assert ": dead; the command of the sweep resumes it" in message(tmp_path)
    status.write_text(json.dumps({name: value for name, value in status_values.items() if name != "pid_began"}))
    assert ": running" in message(tmp_path), "an older program did not say when it began"


def test_it_is_polled_and_imports_nothing_heavy(folder: Path) -> None:
    heavy = "('torch', 'ray', 'mlflow', 'hydra', 'pandas', 'trimesh', 'scipy', 'pydantic')"
    code = (
        f"import sys, shift3d.cli.main as m\nm.main(['sweep', 'status', {str(folder)!r}])\n"
        f"sys.exit(str([name for name in {heavy} if name in sys.modules] or ''))"
    )
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "2 of 2 tasks done" in done.stdout and done.stderr.strip() == "", done.stderr
    assert time.monotonic() - began < 5.0, "well under a second on a machine that does nothing else"


def test_machines_that_are_left_out_are_named(folder: Path) -> None:
    writer = StatusWriter(CommitLog(folder, HASH), 2)
    writer.left_out(["host-a is left out: /data: no such folder. Mount it"])
    writer.write([], 1, "finished")
    assert message(folder).splitlines()[-1] == "host-a is left out: /data: no such folder. Mount it"


@pytest.mark.parametrize("ahead_s", [-3600.0, 3600.0])
def test_a_driver_elsewhere_whose_clock_is_an_hour_off_is_known_by_its_next_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead_s: float
) -> None:
    unfinished(tmp_path, "running")
    monkeypatch.setattr(socket, "gethostname", lambda: "elsewhere")
    monkeypatch.setattr("shift3d.sweep.status._EVERY_S", 0.2)
    status = tmp_path / "status.json"
    values = json.loads(status.read_text())

    def write() -> None:
        now = time.time() + ahead_s
        new = tmp_path / "status.new"
        new.write_text(json.dumps({**values, "written_unix_s": now, "committed_unix_s": now - 7.0}))
        new.replace(status)  # as drivers do: a reader never meets half a file

    write()
    later = threading.Timer(0.2, write)
    later.start()
    shown = message(tmp_path)
    later.join()
    assert ": running" in shown and "last commit 7 s ago" in shown
    if ahead_s < 0:
        assert "silent for 60" in message(tmp_path), "it says nothing more"
