"""The final tables, against values worked out by hand, and their independence of order."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_hand import BOTH_LAMBDAS, catalogue, score_row

from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import read_final, table_from_rows
from shift3d.sweep.execution.worker import attempt_row
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.sweep.results.final import FinalTables, write_final


def rows_of(task: Any, sweep: str) -> list[dict[str, Any]]:
    """Return baseline 0.8, adversarial 0.2 or 0.4 by scene; the loss is lowest for lambda 1."""
    adversarial = 0.2 if task.spec.scene == "north" else 0.4
    loss = {1.0: 0.3, 10.0: 0.6, None: 0.1}[task.spec.lambda_]
    where = {"x_m": 15.0 if task.spec.scene == "north" else 25.0}
    return [
        score_row(task, sweep, "baseline", 0.8, 1.0, **where),
        score_row(task, sweep, "adversarial", adversarial, loss, **where),
    ]


def commit(out: Path, plan: Plan, order: list[int], size: int, skip: tuple[int, ...] = ()) -> FinalTables:
    log = CommitLog(out, plan.spec_hash)
    for start in range(0, len(order), size):
        tasks = [plan.tasks[i] for i in order[start : start + size]]
        done = [task for task in tasks if plan.tasks.index(task) not in skip]
        lost = [task.spec.task_id for task in tasks if task not in done]
        scores = [row for task in done for row in rows_of(task, plan.sweep)]
        attempts = [attempt_row(task.spec.task_id, 1, "done", 0.0, 0.0) for task in done]
        tables = {"scores": table_from_rows("scores", scores), "attempts": table_from_rows("attempts", attempts)}
        log.commit(tuple(task.spec.task_id for task in done), tuple(lost), tables)
    return write_final(out, plan, log.entries)


def test_by_hand(out: Path, suv_plan: Plan) -> None:
    final = commit(out, suv_plan, list(range(6)), 2)
    shape = final.frame("auc").query("mode == 'shape' and method == 'adversarial'")
    assert shape["auc"].tolist() == pytest.approx([0.3, 0.3])
    assert shape["lambda"].tolist() == [1.0, 10.0]
    assert shape["selected"].tolist() == [True, False]
    assert shape["mean_adversarial_loss"].tolist() == pytest.approx([0.3, 0.6])
    pose = final.frame("auc").query("mode == 'pose' and method == 'adversarial'")
    assert pose["selected"].tolist() == [True] and pose["auc"].item() == pytest.approx(0.3)
    bev = final.frame("bev").query("mode == 'pose' and method == 'adversarial'")
    assert bev[["cell_x_m", "cell_y_m", "scores"]].to_numpy().tolist() == [[10.0, -10.0, 1.0], [20.0, -10.0, 1.0]]
    assert bev["mean_reduction"].tolist() == pytest.approx([0.6, 0.4])


def test_curves_have_the_auc_for_their_area(out: Path, suv_plan: Plan) -> None:
    final = commit(out, suv_plan, list(range(6)), 6)
    auc, curves = final.frame("auc"), final.frame("curves")
    keys = ["mode", "lambda", "method"]
    areas = {
        key: float((group["recall"].to_numpy()[:-1] * np.diff(group["score_threshold"])).sum())
        for key, group in curves.fillna({"lambda": -1}).groupby(keys)
    }
    for key, group in auc[auc["scores"] > 0].fillna({"lambda": -1}).groupby(keys):
        assert areas[key] == pytest.approx(group["auc"].item())


def test_order_and_size_of_commits_change_no_byte(tmp_path: Path, suv_plan: Plan) -> None:
    commit(tmp_path / "a", suv_plan, [0, 1, 2, 3, 4, 5], 6)
    commit(tmp_path / "b", suv_plan, [5, 2, 0, 4, 1, 3], 1)
    for name in ("scores", "solutions", "curves", "auc", "bev"):
        file = f"final/{name}.parquet"
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), name


def test_a_sweep_is_not_finished_before_its_last_table_is_written(out: Path, suv_plan: Plan) -> None:
    obstacle = out / "final" / "skipped_scenes.parquet"  # of the last table but scores
    obstacle.mkdir(parents=True)
    with pytest.raises(InputError, match="skipped_scenes"):
        commit(out, suv_plan, list(range(6)), 6)
    assert (out / "final" / "choices.parquet").is_file()
    with pytest.raises(InputError, match="the sweep is not finished"):
        read_final(out, "scores")
    obstacle.rmdir()
    write_final(out, suv_plan, read_log(out))
    assert read_final(out, "scores").num_rows


def test_gaps_are_rows(out: Path, suv_plan: Plan) -> None:
    """Both pose tasks failed: their AUC is null, their plan is shown."""
    final = commit(out, suv_plan, list(range(6)), 3, skip=(4, 5))
    pose = final.frame("auc").query("mode == 'pose'")
    assert pose["method"].tolist() == ["baseline", "random", "adversarial"]
    assert pose["auc"].isna().all() and (pose["tasks_planned"] == 2).all() and (pose["tasks_scored"] == 0).all()


def test_draws_that_nobody_asked_for_are_no_gap(out: Path) -> None:
    words = ["vehicle=suv", "attack.random_replicates=0", "attack.noise_replicates=0"]
    plan = make_plan(compose_sweep("default", words), catalogue)[0]
    every = list(range(len(plan.tasks)))
    final = commit(out, plan, every, 3, skip=tuple(every))
    assert set(final.frame("auc")["method"]) == {"baseline", "adversarial"}


@pytest.mark.parametrize("values", ["2,0", "0,2"])
def test_a_method_that_an_axis_turns_off_and_on_is_a_gap_where_nothing_was_scored(out: Path, values: str) -> None:
    words = ["vehicle=suv", "mode=shape", f"attack.noise_replicates={values}"]
    plan = make_plan(compose_sweep("default", words), catalogue)[0]
    every = list(range(len(plan.tasks)))
    final = commit(out, plan, every, 3, skip=tuple(every))
    assert final.frame("auc")["method"].tolist() == ["baseline", "random", "adversarial_noise", "adversarial"]


def test_each_scoring_detector_has_its_own_figures(out: Path) -> None:
    """The second detector scores everything 0.5, and its loss prefers lambda 10: the attacked detector's choice stays.

    One pose task has no score: its gap is a row for each detector.
    """
    detectors = {"pointpillars": "p", "sst": "s"}
    composed = compose_sweep("default", [*BOTH_LAMBDAS, "vehicle=suv", "scene=north"])
    plan = make_plan(composed, lambda config: dataclasses.replace(catalogue(config), detectors=detectors))[0]
    log = CommitLog(out, plan.spec_hash)
    rows = [row for task in plan.tasks[:2] for row in rows_of(task, plan.sweep)]
    second = [{**row, "scored_by": "sst", "score": 0.5, "adversarial_loss": 9.0 / row["lambda"]} for row in rows]
    log.commit(
        tuple(task.spec.task_id for task in plan.tasks[:2]),
        (plan.tasks[2].spec.task_id,),
        {"scores": table_from_rows("scores", rows + second)},
    )
    final = write_final(out, plan, log.entries)
    auc = final.frame("auc")
    shape = auc[(auc["mode"] == "shape") & (auc["method"] == "adversarial")]
    assert shape.groupby("scored_by")["auc"].max().to_dict() == pytest.approx({"pointpillars": 0.2, "sst": 0.5})
    assert set(shape.loc[shape["selected"], "lambda"]) == {1.0} and shape["selected"].sum() == 2
    gaps = auc[auc["mode"] == "pose"]
    assert gaps.groupby("scored_by")["method"].apply(list).to_dict() == {
        name: ["baseline", "random", "adversarial"] for name in detectors
    }
    bev = final.frame("bev").query("method == 'adversarial' and `lambda` == 1")
    assert bev.set_index("scored_by")["mean_reduction"].to_dict() == pytest.approx({"pointpillars": 0.6, "sst": 0.0})
    curves = final.frame("curves").query("method == 'adversarial' and `lambda` == 1 and scored_by == 'sst'")
    assert curves.loc[curves["recall"] > 0, "score_threshold"].max() <= 0.5


def test_nothing_but_failures_is_still_a_sweep(out: Path, suv_plan: Plan) -> None:
    final = commit(out, suv_plan, list(range(6)), 3, skip=tuple(range(6)))
    assert final.frame("scores").empty and final.frame("auc")["auc"].isna().all()
