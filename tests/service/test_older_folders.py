"""Folders that older programs began are read, finished and compacted as if this program had begun them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from cheap_task import KIND
from drivers import DETERMINISTIC

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.settings.schema import LocalRunnerConfig
from shift3d.store.log import CommitLog, read_log
from shift3d.store.migrations import STEPS, steps
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS
from shift3d.store.tables import read_table, table_from_rows
from shift3d.sweep.drive import run_sweep
from shift3d.sweep.planning.folder import open_folder, read_plan, read_spec

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
LOCAL = LocalRunnerConfig(kind="local", commit_seconds=0, abort_after=None, abort_share=None)


def final(folder: Path) -> dict[str, bytes]:
    return {name: (folder / "final" / f"{name}.parquet").read_bytes() for name in DETERMINISTIC}


def test_every_version_that_can_be_read_has_a_step_and_a_folder() -> None:
    assert sorted(STEPS) == list(range(min(STEPS), SCHEMA_VERSION))
    for version in STEPS:
        assert f"schema_version: {version}\n" in (REFERENCE / f"schema_{version}" / "spec.yaml").read_text()
        assert f'{version}: "' in (REFERENCE / "make_schema_folder.py").read_text()


@pytest.mark.parametrize("version", sorted(STEPS))
def test_a_sweep_that_an_older_program_began_is_finished(version: int, tmp_path: Path) -> None:
    old = Path(shutil.copytree(REFERENCE / f"schema_{version}", tmp_path / "old"))
    plan = read_plan(old)
    assert read_spec(old)["schema_version"] == SCHEMA_VERSION
    assert [len(entry.done) for entry in read_log(old)] == [0, 1, 1]
    assert run_sweep(plan, LOCAL, KIND, tmp_path / "new").done == 4
    result = run_sweep(plan, LOCAL, KIND, old)
    assert (result.done, result.quarantined) == (4, 0)
    assert sum(len(entry.done) for entry in read_log(old)) == 4, "what was done is not run again"
    assert final(old) == final(tmp_path / "new")
    assert main(["compact", str(old)]) == 0
    assert run_sweep(plan, LOCAL, KIND, old).done == 4
    assert final(old) == final(tmp_path / "new")


def test_shapes_that_were_called_cars_by_their_sides_alone_are_not_called_so_any_more(tmp_path: Path) -> None:
    """Version 7 asks for volume and symmetry, which version 6 did not measure."""
    row: dict[str, object] = {field.name: None for field in SCHEMAS["shapes"]}
    row |= {"task_id": "t", "sweep": "s", "vehicle": "v", "scene": "s", "dataset": "d", "mode": "shape", "alpha": 0.1}
    row |= {"detector": "p", "accuracy": "a", "search": "descent", "method": "adversarial", "replicate": 0}
    table = table_from_rows("shapes", [row | {"largest_piece": 0.99, "still_a_car": True}])
    metadata = {**table.schema.metadata, b"shift3d.schema_version": b"6"}
    older = table.drop_columns(["volume_share", "mirrored", "search"]).replace_schema_metadata(metadata)
    pq.write_table(older, tmp_path / "shapes.parquet")
    (found,) = read_table(tmp_path / "shapes.parquet", "shapes").to_pylist()
    assert (found["largest_piece"], found["volume_share"], found["mirrored"]) == (0.99, None, None)
    assert found["still_a_car"] is None


def test_files_of_a_newer_version_are_refused_by_name(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(REFERENCE / "schema_5", tmp_path / "folder"))
    plan = read_plan(folder)
    newer = SCHEMA_VERSION + 1
    entry = folder / "_log" / "00000001.json"
    entry.write_text(json.dumps({**json.loads(entry.read_text()), "schema_version": newer}))
    with pytest.raises(InputError, match=f"version {newer}, this program reads 5 to {SCHEMA_VERSION}.*newer shift3d"):
        CommitLog(folder, plan.spec_hash)
    segment = next((folder / "data").glob("*-scores.parquet"))
    metadata = {"shift3d.schema": "scores", "shift3d.schema_version": str(newer)}
    pq.write_table(pq.read_table(segment, partitioning=None).replace_schema_metadata(metadata), segment)
    with pytest.raises(InputError, match=f"has schema version {newer}") as failure:
        read_table(segment, "scores")
    assert segment.name in failure.value.where
    spec = folder / "spec.yaml"
    spec.write_text(spec.read_text().replace("schema_version: 5", f"schema_version: {newer}"))
    for read in (read_plan, lambda out: open_folder(out, plan)):
        with pytest.raises(InputError, match="Use a newer shift3d"):
            read(folder)


@pytest.mark.parametrize("version", [0, -1, 4, True, "5", None, 5.0, [5]])
def test_what_is_no_version_is_refused(version: object) -> None:
    with pytest.raises(InputError, match="has schema version"):
        steps(version, "spec.yaml")
