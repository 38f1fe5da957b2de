"""From places to a measured frontier: errors are reported first, and results belong to the measured code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from shift3d.accuracy_time import drive
from shift3d.accuracy_time.journal import Journal
from shift3d.cli.commands import frontier
from shift3d.errors import InputError
from shift3d.task.assets import load_assets

_MEASURES_NOTHING = {
    *("effects", "errors", "exit_codes", "naturalness", "processes", "progress_bar", "seeding", "settings", "store"),
    *("training", "wording"),
}
"""Packages that read settings, keep tables, format texts, draw places (part of a case), or serve other tasks alone."""


def test_a_case_without_a_place_is_said_before_another_is_measured(tmp_path: Path) -> None:
    words = ["scenes.count=1", "frontier.cases=[{vehicle:suv,range_m:15},{vehicle:omnibus,range_m:20}]"]
    config = frontier._config(words)
    plan, _ = frontier.plan_of(config, "^draft$", quick=False)
    with pytest.raises(InputError, match="omnibus"):
        drive.measure_frontier(frontier.groups_of(config), plan, tmp_path, False, lambda *_: None)
    assert not list(tmp_path.iterdir())


def test_a_stopped_run_that_measures_everything_again_leaves_no_earlier_measurement_to_resume_from(
    tmp_path: Path,
) -> None:
    config = frontier._config(["scenes.count=1", "frontier.cases=[{vehicle:suv,range_m:15},{vehicle:suv,range_m:20}]"])
    plan, _ = frontier.plan_of(config, "^draft$", quick=False)
    (group,) = frontier.groups_of(config)
    assets = load_assets(group.assets)
    names = [drive._folder_name(case, plan, assets, group) for case in drive._cases(group, plan, assets)]
    journals = [tmp_path / "measured" / name / "journal.jsonl" for name in names]
    for journal in journals:
        Journal(journal).put("look/earlier", 1.0)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive.measure_frontier([group], plan, tmp_path, False, stop)
    assert all(journal.is_file() for journal in journals)
    with pytest.raises(KeyboardInterrupt):
        drive.measure_frontier([group], plan, tmp_path, True, stop)
    assert not any(journal.is_file() for journal in journals)


def test_what_was_measured_is_measured_again_after_a_change_of_what_it_is_made_with() -> None:
    listing = "import sys, shift3d.accuracy_time.drive; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", listing], capture_output=True, text=True, check=True).stdout.split()
    rooms = {name.split(".")[1] for name in loaded if name.startswith("shift3d.")}
    assert rooms - _MEASURES_NOTHING == {part.removesuffix(".py") for part in drive._CODE}
