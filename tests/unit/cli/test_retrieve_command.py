"""A retrieval that is impossible is refused before a pool is made."""

from __future__ import annotations

from pathlib import Path

import pytest
import valid_sweeps

from shift3d.cli.main import main
from shift3d.exit_codes import ExitCode
from shift3d.settings.compose import compose_sweep
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import table_from_rows
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.results.final import write_final


def test_a_sweep_of_poses_has_no_kin_to_look_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    plan, _ = make_plan(compose_sweep("smoke", ["vehicle=suv", "mode=pose"]), valid_sweeps.catalogue)
    folder = tmp_path / "sweep"
    open_folder(folder, plan)
    log = CommitLog(folder, plan.spec_hash)
    for task in plan.tasks:
        names = ("scores", "solutions", "timings", "attempts")
        segments = {name: table_from_rows(name, valid_sweeps.rows(name, task)) for name in names}
        log.commit((task.spec.task_id,), (), segments)
    write_final(folder, read_plan(folder), read_log(folder))
    assert main(["retrieve", str(folder), "runner=local"]) == ExitCode.UNUSABLE
    printed = capsys.readouterr()
    assert "no task searched a shape" in printed.err and "fitting" not in printed.out
    assert [path.name for path in tmp_path.iterdir()] == ["sweep"]
