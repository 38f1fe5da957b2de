"""A grown grid takes over the results of another sweep, runs the rest, and ends with a fresh run's bytes."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from cheap_task import KIND
from drivers import Drivers

from shift3d.cli.commands import plan, sweep
from shift3d.cli.main import parse

SMALL, GROWN = 60, 90  # 5 vehicles, 4 or 6 scenes, shape under two lambda and pose
GROW = ("runner=local", "scenes.count=6")


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Files of final/ of the grown grid, run without results to take over."""
    drivers = Drivers(tmp_path_factory.mktemp("fresh"))
    code, _, errors = drivers.run("out", *GROW)
    assert code == 0, errors
    return drivers.final("out")


def ran(journal: Path) -> list[str]:
    return journal.read_text().split() if journal.exists() else []


def rows_in(folder: Path, table: str) -> int:
    return sum(pq.read_metadata(path).num_rows for path in (folder / "data").glob(f"*-{table}.parquet"))


def once(tasks: Iterable[str]) -> bool:
    tasks = list(tasks)
    return len(tasks) == len(set(tasks))


def test_only_new_tasks_run(drivers: Drivers, undisturbed_folder: Path, fresh: dict[str, bytes]) -> None:
    journal = drivers.folder / "journal"
    source = Path(shutil.copytree(undisturbed_folder, drivers.folder / "small"))
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    code, output, errors = drivers.run("out", *GROW, f"reuse={source}", SHIFT3D_TEST_JOURNAL=str(journal))
    assert code == 0, errors
    assert f"{SMALL} of {GROWN} tasks copied from {source}" in output
    assert len(ran(journal)) == GROWN - SMALL and not set(ran(journal)) & set(drivers.committed("small"))
    assert before == {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}, "it was only read"
    assert len(drivers.committed("out")) == GROWN and once(drivers.committed("out"))
    # The folder does not need the other one: a second run makes the same tables from its own data.
    shutil.rmtree(source)
    shutil.rmtree(drivers.folder / "out" / "final")
    assert drivers.run("out", *GROW)[0] == 0
    assert drivers.final("out") == fresh
    assert len(ran(journal)) == GROWN - SMALL


def test_of_an_unfinished_sweep_what_it_committed_and_nothing_that_failed(
    drivers: Drivers, fresh: dict[str, bytes]
) -> None:
    """The source quarantined one task and lost its last commits."""
    journal = drivers.folder / "journal"
    small = ("runner=local", "runner.commit_seconds=0")
    assert drivers.run("small", *small, SHIFT3D_TEST_FAILS="coupe/street_001/pose")[0] == 3
    log = sorted((drivers.folder / "small" / "_log").glob("[0-9]*.json"))
    for entry in log[len(log) // 2 :]:
        entry.unlink()
    done = drivers.committed("small")
    assert 0 < len(done) < SMALL - 1
    code, _, errors = drivers.run(
        "out", *GROW, "--reuse", str(drivers.folder / "small"), SHIFT3D_TEST_JOURNAL=str(journal)
    )
    assert code == 0, errors
    assert len(ran(journal)) == GROWN - len(done) and not set(ran(journal)) & set(done)
    assert drivers.final("out") == fresh
    assert rows_in(drivers.folder / "out", "attempts") == GROWN, "a quarantined task was taken over"


def test_a_driver_that_is_run_again_takes_nothing_twice(
    drivers: Drivers, undisturbed_folder: Path, fresh: dict[str, bytes]
) -> None:
    words = (*GROW, f"reuse={undisturbed_folder}")
    assert drivers.run("out", *words)[0] == 0
    rows = rows_in(drivers.folder / "out", "scores")
    code, output, _ = drivers.run("out", *words)
    assert code == 0 and "tasks copied from" not in output
    assert rows_in(drivers.folder / "out", "scores") == rows and once(drivers.committed("out"))
    assert drivers.final("out") == fresh


def test_what_cannot_be_reused_is_one_line_and_runs_nothing(drivers: Drivers, finished: Path) -> None:
    journal = drivers.folder / "journal"
    code, _, errors = drivers.run("new", *GROW, f"reuse={drivers.folder / 'none'}", SHIFT3D_TEST_JOURNAL=str(journal))
    assert code == 2 and "is not the output folder of a sweep" in errors
    (finished / "_log" / "00000001.json").write_text('{"torn')
    code, _, errors = drivers.run("new", *GROW, f"reuse={finished}", SHIFT3D_TEST_JOURNAL=str(journal))
    assert code == 2 and "00000001.json" in errors and not ran(journal)


@pytest.mark.parametrize("words", [("sweep", "plan"), ("plan",)], ids=" ".join)
def test_the_plan_is_shown_with_what_is_left_and_nothing_runs(
    words: tuple[str, ...], undisturbed_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grown = ["default", "scenes.count=6", "attack.lambda=1,10"]
    arguments = parse([*words, *grown, f"reuse={undisturbed_folder}", f"out={tmp_path / 'out'}"])
    assert (sweep.run_with(arguments, KIND) if words[0] == "sweep" else plan.show(arguments.words, KIND)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7 and lines[0].startswith(f"sweep default: {GROWN} tasks (60 shape, 30 pose)")
    assert lines[2] == f"{SMALL} of {GROWN} tasks are done already"
    assert lines[3].startswith("expected run time: ") and f" core-hours, for {GROWN - SMALL} tasks of " in lines[3]
    assert f"{SMALL} tasks that ran in {undisturbed_folder}" in lines[4]
    assert not (tmp_path / "out").exists()
