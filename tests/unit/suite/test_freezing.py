"""A frozen object scores as in the sweep, bit for bit, from its own bytes or from the frames."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.store.resolve import as_location
from shift3d.store.tables import read_table, table_from_rows, write_table
from shift3d.suite import freezing
from shift3d.suite.freezing import FreezeResult, freeze_suite
from shift3d.suite.frozen import manifest_bytes, read_suite
from shift3d.suite.scoring import Scorer, score_suite
from shift3d.suite.selection import SelectionRule, select_solutions
from shift3d.suite.writer import SuiteWriter
from shift3d.sweep.execution.worker import completed_rows
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import make_plan
from shift3d.task.assets import load_assets
from shift3d.task.run import run_task
from shift3d.task.scoring import score_box
from shift3d.task.spec import TaskSpec

WORDS = ["vehicle=suv", "mode=shape,pose", "scenes.count=2", "scenes.sensor=hdl64", "attack.steps=1",
         "attack.random_replicates=0", "attack.noise_replicates=0", "naturalness=none"]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A real sweep with shipped weights and its final tables: a shape and a pose in one scene, a pose in another."""
    folder = tmp_path_factory.mktemp("whole")
    plan = make_plan(compose_sweep("smoke", WORDS), read_catalogue)[0]
    open_folder(folder, plan)
    assets, first = load_assets(plan.assets[0]), plan.tasks[0].spec.scene
    specs = [task.spec for task in plan.tasks if task.spec.scene == first or task.spec.mode == "pose"]
    found = [completed_rows(spec, plan.sweep, run_task(spec, assets)) for spec in specs]
    for name in ("scores", "solutions"):
        table = table_from_rows(name, [row for rows in found for row in rows[name]])
        write_table(folder / "final" / f"{name}.parquet", table)
    return folder


def part_of(whole: Path, folder: Path, wanted: Callable[[TaskSpec], bool]) -> Path:
    """Copy a sweep as if it had no other tasks than the wanted ones."""
    ids = {task.spec.task_id for task in read_plan(whole).tasks if wanted(task.spec)}
    shutil.copytree(whole, folder)
    for name in ("scores", "solutions"):
        path = folder / "final" / f"{name}.parquet"
        rows = [row for row in read_table(path, name).to_pylist() if row["task_id"] in ids]
        write_table(path, table_from_rows(name, rows))
    return folder


@pytest.fixture(scope="module")
def sweep(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shape and the pose in one scene."""
    first = read_plan(whole).tasks[0].spec.scene
    return part_of(whole, tmp_path_factory.mktemp("sweep") / "one", lambda spec: spec.scene == first)


@pytest.fixture(scope="module")
def frozen(sweep: Path, tmp_path_factory: pytest.TempPathFactory) -> FreezeResult:
    return freeze_suite(sweep, tmp_path_factory.mktemp("suite"), SelectionRule())


def test_frozen_objects_are_scored_as_the_sweep_scored_them(frozen: FreezeResult, sweep: Path, tmp_path: Path) -> None:
    suite = frozen.suite
    assert suite.objects["role"].tolist() == ["control", "hard", "hard"], "both tasks have one baseline"
    assert set(suite.objects["control"].dropna()) == {suite.objects["object_id"].iloc[0]}
    assert suite.manifest["scenes"] == 1 and suite.manifest["scene_sets"] == []
    answers = pd.concat(score_suite(suite, Scorer("pointpillars"), as_location(tmp_path)))
    again = dict(zip(answers["object_id"], answers["score"], strict=True))
    scores = read_table(sweep / "final" / "scores.parquet", "scores").to_pandas()
    for row in suite.objects.to_dict("records"):
        same = (scores["task_id"] == row["task_id"]) & (scores["method"] == row["method"])
        assert again[row["object_id"]] == scores[same]["score"].item()  # bit for bit
        assert scores[same]["object_points"].item() == len(row["hits"]) == row["object_points"]
    assert frozen.largest_difference == 0.0 and frozen.unverified == 2


def test_the_same_call_writes_nothing_again_and_another_one_is_refused(frozen: FreezeResult, sweep: Path) -> None:
    to = Path(str(frozen.suite.folder))
    before = {path: path.stat().st_mtime_ns for path in to.rglob("*")}
    known = freeze_suite(sweep, to, SelectionRule())
    assert known.largest_difference is None and known.suite.digest == frozen.suite.digest
    assert {path: path.stat().st_mtime_ns for path in to.rglob("*")} == before
    with pytest.raises(InputError, match="holds another suite"):
        freeze_suite(sweep, to, SelectionRule(count=1))
    with pytest.raises(InputError, match="not empty"):
        freeze_suite(sweep, sweep, SelectionRule())


class Killed(BaseException):
    """Ends a freezing as a signal does."""


def test_a_killed_freezing_goes_on_with_the_scenes_that_it_finished_to_the_same_bytes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = part_of(whole, tmp_path / "sweep", lambda spec: spec.mode == "pose")
    alone = SelectionRule(controls=False)
    at_once = freeze_suite(sweep, tmp_path / "whole", alone)
    assert at_once.suite.manifest["scenes"] == 2
    scored = []

    def last_scene_is_killed(*arguments: object) -> object:
        scored.append(1)
        if len(scored) == 2:  # of the second scene
            raise Killed
        return score_box(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(freezing, "score_box", last_scene_is_killed)
    with pytest.raises(Killed):
        freeze_suite(sweep, tmp_path / "killed", alone)
    shutil.copytree(tmp_path / "killed", tmp_path / "lost")
    resumed = freeze_suite(sweep, tmp_path / "killed", alone)
    assert len(scored) == 2 + 1, "the first scene's object is not scored again"
    shutil.rmtree(tmp_path / "lost" / "backgrounds")
    freeze_suite(sweep, tmp_path / "lost", alone)
    assert tree(tmp_path / "lost") == tree(tmp_path / "whole"), "a scene without its background is frozen once more"
    assert resumed.suite.digest == at_once.suite.digest
    assert tree(tmp_path / "killed") == tree(tmp_path / "whole")


def test_a_suite_killed_after_its_last_scene_is_not_said_to_have_existed(
    sweep: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def killed(*_: object) -> bytes:
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(freezing, "manifest_bytes", killed)
        freeze_suite(sweep, tmp_path, SelectionRule())
    assert main(["suite", str(sweep), f"to={tmp_path}"]) == 0 and (tmp_path / "suite.json").is_file()
    printed = capsys.readouterr().out
    assert "no object was scored again" in printed and "nothing was written" not in printed


def test_referenced_frames_are_made_again_and_must_be_the_same(
    frozen: FreezeResult, sweep: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scored: list[object] = []
    monkeypatch.setattr(freezing, "score_box", lambda *words: (scored.append(words), score_box(*words))[1])
    suite = freeze_suite(sweep, tmp_path, SelectionRule(), "referenced").suite
    assert len(scored) == len(suite.objects) == 3, "the control of both tasks is scored once"
    assert not (tmp_path / "backgrounds").exists()
    name = suite.objects["background"].iloc[0]
    assert np.array_equal(suite.background(name), frozen.suite.background(name))
    assert suite.objects["object_id"].tolist() == frozen.suite.objects["object_id"].tolist()
    manifest = json.loads((tmp_path / "suite.json").read_bytes())
    other = {**manifest["scene_sets"][0], "seed": 1}
    (tmp_path / "suite.json").write_bytes(manifest_bytes({**manifest, "scene_sets": [other]}))
    with pytest.raises(InputError, match="unknown scene"):
        read_suite(tmp_path).background(name)
    suite.objects["scene_hash"] = "of other points"
    with pytest.raises(InputError, match="differs from the frame"):
        suite.background(name)
    kitti = {"kind": "kitti", "root": str(tmp_path), "count": None, "names": None}
    (tmp_path / "suite.json").write_bytes(manifest_bytes({**manifest, "scene_sets": [kitti]}))
    with pytest.raises(InputError, match=str(tmp_path / "elsewhere")):
        read_suite(tmp_path, root=str(tmp_path / "elsewhere")).background(name)


def test_a_vehicle_of_another_kind_has_that_kinds_name_and_size(sweep: Path, tmp_path: Path) -> None:
    """A search over kinds turns an SUV into a coupe: a gate must name the missed kind."""
    plan = read_plan(sweep)
    assets = load_assets(plan.assets[0])
    coupe = assets.vehicles.vehicle("coupe")
    own = read_table(sweep / "final" / "solutions.parquet", "solutions").to_pylist()[0]
    turned = own | {"drawn_as": "coupe", "latent_code": coupe.latent_code.tolist()}
    writing = SuiteWriter(as_location(tmp_path), "referenced", "")
    rows = [freezing._object(plan.tasks[0].spec, row, assets, writing)[0] for row in (own, turned)]
    assert [row["vehicle"] for row in rows] == ["suv", "coupe"]
    assert rows[1]["dx_m"] == coupe.size_m[0] != rows[0]["dx_m"]


def test_controls_alone_are_no_suite(sweep: Path, tmp_path: Path) -> None:
    """A gate would score all of them without any finding."""
    other = Path(shutil.copytree(sweep, tmp_path / "other"))
    path = other / "final" / "scores.parquet"
    rows = read_table(path, "scores").to_pylist()
    changed = [row | {"score": 1.0} if row["method"] == "adversarial" else row for row in rows]
    write_table(path, table_from_rows("scores", changed))
    with pytest.raises(InputError, match="no object has the score that the sweep reports"):
        freeze_suite(other, tmp_path / "suite", SelectionRule())
    assert not (tmp_path / "suite" / "suite.json").exists()


def test_a_street_seen_by_two_sensors_counts_as_one_scene() -> None:
    street = {"dataset": "street-mixed", "scene": "street-test-hdl64-000000"}
    other = {"dataset": "street-mixed-hdl32", "scene": "street-test-hdl64-000000-hdl32"}
    assert freezing.number_of_scenes([street, other]) == 1
    assert freezing.number_of_scenes([street, street | {"scene": "street-test-waymo_top-000001"}]) == 2


def test_what_is_eligible_and_which_are_taken(sweep: Path, tmp_path: Path) -> None:
    scores = read_table(sweep / "final" / "scores.parquet", "scores").to_pandas()
    one = scores[scores["method"] == "adversarial"].iloc[0].to_dict()
    faults = [
        {"stable": False}, {"natural": False}, {"overlap_ok": False}, {"contact_ok": False}, {"best_step": 0},
        {"status": "no_valid_step"}, {"score": None},
    ]  # fmt: skip
    fine = [{"score": 0.01 * number, "stable": True} for number in range(20)]
    fine[7] |= {"status": "diverged"}  # its earlier result counts
    fine[8] |= {"mode": "pose", "natural": False}  # a car that the reference set lacks, moved
    rows = [{**one, **change, "task_id": f"{number:032x}"} for number, change in enumerate([*fine, *faults])]
    rows = [{key: _plain(value) for key, value in row.items()} for row in rows]
    write_table(tmp_path / "final" / "scores.parquet", table_from_rows("scores", rows))
    known = read_table(sweep / "final" / "solutions.parquet", "solutions").to_pylist()
    solutions = [
        {**known[0], "task_id": row["task_id"], "method": method}
        for row in rows
        for method in ("baseline", "adversarial")
    ]
    write_table(tmp_path / "final" / "solutions.parquet", table_from_rows("solutions", solutions))
    chosen = select_solutions(as_location(tmp_path), SelectionRule())
    assert len(chosen.hard) == len(chosen.controls) == 20 and chosen.unverified == 0
    assert sum(chosen.left_out.values()) == len(faults) == len(chosen.left_out)
    hardest = select_solutions(as_location(tmp_path), SelectionRule(count=5, by="hardest"))
    assert hardest.hard["task_id"].tolist() == [f"{number:032x}" for number in range(5)]
    drawn = [
        select_solutions(as_location(tmp_path), SelectionRule(count=5, seed=seed)).hard["task_id"] for seed in (0, 0, 1)
    ]
    assert drawn[0].tolist() == drawn[1].tolist() != drawn[2].tolist()
    assert select_solutions(as_location(tmp_path), SelectionRule(controls=False)).controls.empty
    with pytest.raises(InputError, match="has no method 'random'"):
        select_solutions(as_location(tmp_path), SelectionRule(method="random"))
    write_table(tmp_path / "final" / "scores.parquet", table_from_rows("scores", rows[-1:]))
    with pytest.raises(InputError, match="no adversarial object can be frozen: 1 without a score"):
        select_solutions(as_location(tmp_path), SelectionRule())


def tree(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return None if value is None or value is pd.NA or value != value else value
