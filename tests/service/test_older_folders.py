"""Folders begun by older programs are read, finished and compacted like folders of this program."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cheap_task import KIND
from drivers import DETERMINISTIC

from shift3d.analysis.results import natural_by_task
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.settings.schema.config import LocalRunnerConfig
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.migrations import OLDEST_VERSION, older_versions
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS
from shift3d.store.tables import read_table, table_from_rows
from shift3d.sweep.drive import run_sweep
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.spec_file import read_spec

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
LOCAL = LocalRunnerConfig(kind="local", commit_seconds=0, abort_after=None, abort_share=None)


def final(folder: Path) -> dict[str, bytes]:
    return {name: (folder / "final" / f"{name}.parquet").read_bytes() for name in DETERMINISTIC}


OLDER = range(OLDEST_VERSION, SCHEMA_VERSION)


def test_every_version_that_can_be_read_has_a_folder() -> None:
    for version in OLDER:
        spec, maker = REFERENCE / f"schema_{version}" / "spec.yaml", REFERENCE / "make_schema_folder.py"
        assert spec.is_file(), f"{maker.name} makes schema_{version} at the last commit of that version: see its head"
        assert f"schema_version: {version}\n" in spec.read_text()
        assert f'{version}: "' in maker.read_text(), f"{maker.name}: add the commit of version {version} to COMMITS"


@pytest.mark.parametrize("version", [version for version in OLDER if (REFERENCE / f"schema_{version}").is_dir()])
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


def older_file(path: Path, name: str, version: int, gone: list[str], row: dict[str, object]) -> None:
    """Write a table with one row as a program of some version did. row: also values of columns dropped since."""
    today: dict[str, object] = {field.name: None for field in SCHEMAS[name]}
    known = {"task_id": "t", "sweep": "s", "vehicle": "v", "scene": "s", "dataset": "d", "mode": "shape", "alpha": 0.1}
    known |= {
        "search": "descent",
        "detector": "p",
        "accuracy": "a",
        "method": "adversarial",
        "replicate": 0,
        "largest_piece": 0.99,
    }
    known |= {"scored_by": "p", "effects": [], "status": "ok", "score": 0.5, "height_m": 1.5}
    values = {key: value for key, value in (today | known | row).items() if key in today}
    table = table_from_rows(name, [values]).drop_columns(gone)
    for key in row.keys() - today.keys():
        table = table.append_column(key, pa.array([row[key]]))
    metadata = {**SCHEMAS[name].metadata, b"shift3d.schema_version": str(version).encode()}
    pq.write_table(table.replace_schema_metadata(metadata), path)


SCORED = ["surface_distance_cm", "surface_distance_p95_cm", "naturalness_percentile", "natural"]
LOOKED_AT = ["clearance_m", "asymmetry_cm", "nearest_member", "to_member_cm", "to_member_p95_cm", "from_member_cm"]
LOOKED_AT += ["from_member_p95_cm", "out_of_range"]


@pytest.mark.parametrize("version", [6, 7, 8])
def test_shapes_that_another_rule_called_cars_are_of_unknown_naturalness(version: int, tmp_path: Path) -> None:
    """Version 9 measures naturalness; earlier programs tested sides, volume and symmetry, or sides alone."""
    judged: dict[str, object] = {"still_a_car": True}
    if version >= 7:
        judged |= {"volume_share": 1.0, "mirrored": 0.99}
    gone = LOOKED_AT if version == 8 else [*LOOKED_AT, "search"]
    older_file(tmp_path / "shapes.parquet", "shapes", version, gone, judged)
    read = read_table(tmp_path / "shapes.parquet", "shapes")
    assert read.schema.equals(SCHEMAS["shapes"])
    (found,) = read.to_pylist()
    assert (found["largest_piece"], found["height_m"]) == (0.99, 1.5)
    assert all(found[name] is None for name in LOOKED_AT)


def test_scores_of_an_older_program_are_read_without_naturalness(tmp_path: Path) -> None:
    older_file(tmp_path / "scores.parquet", "scores", 8, SCORED, {})
    read = read_table(tmp_path / "scores.parquet", "scores")
    assert read.schema.equals(SCHEMAS["scores"])
    assert [read[name].to_pylist() for name in SCORED] == [[None]] * 4 and read["score"].to_pylist() == [0.5]
    assert natural_by_task(read.to_pandas()) == {}


def test_solutions_of_an_older_program_are_drawn_as_their_own_vehicle(tmp_path: Path) -> None:
    pose = dict.fromkeys(("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad"), 0.0)
    older_file(tmp_path / "solutions.parquet", "solutions", 9, ["drawn_as"], {"latent_code": [0.5], **pose})
    read = read_table(tmp_path / "solutions.parquet", "solutions")
    assert read.schema.equals(SCHEMAS["solutions"])
    assert read["drawn_as"].to_pylist() == [None] and read["latent_code"].to_pylist() == [[0.5]]


def test_the_best_of_random_draws_of_an_older_program_is_named_by_its_budget(tmp_path: Path) -> None:
    older_file(tmp_path / "scores.parquet", "scores", 10, [], {"method": "random_search"})
    older_file(tmp_path / "others.parquet", "scores", 10, [], {"method": "random"})
    methods = [read_table(file, "scores")["method"].to_pylist() for file in sorted(tmp_path.iterdir())]
    assert methods == [["random"], ["random_budget"]]


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
        older_versions(version, "spec.yaml")
