"""The printed tables agree with the frames."""

from __future__ import annotations

from typing import Any

import pandas as pd

from shift3d.analysis.tables.auc import auc_table
from shift3d.analysis.tables.coverage import coverage_lines, missing_search_scenes, stage_times
from shift3d.analysis.variants import variants
from shift3d.task.spec import AttackSpec


def auc_row(vehicle: str, method: str, auc: float | None, scores: int = 4, **more: Any) -> dict[str, Any]:
    row = {"dataset": "street-hdl64", "vehicle": vehicle, "mode": "shape", "lambda": 1.0, "alpha": 0.01}
    row |= {
        "detector": "pointpillars",
        "scored_by": "pointpillars",
        "accuracy": "standard",
        "search": "descent",
        "effects": "auto",
    }
    return {**row, "method": method, "auc": auc, "scores": scores, "selected": True, **more}


def auc_tables(rows: pd.DataFrame) -> list[str]:
    return [str(auc_table(variant)) for variant in variants(rows)]


def cells(table: str, label: str) -> list[str]:
    return next(line for line in table.splitlines() if line.startswith(f"{label}  ")).removeprefix(label).split()


def test_rows_columns_mean_and_ratio() -> None:
    rows = [
        auc_row("coupe", "baseline", 0.8),
        auc_row("coupe", "adversarial", 0.4),
        auc_row("suv", "baseline", 0.6),
        auc_row("suv", "adversarial", 0.3),
        auc_row("suv", "adversarial", 0.9, selected=False, **{"lambda": 10.0}),
    ]
    (table,) = auc_tables(pd.DataFrame(rows))
    assert table.splitlines()[0] == "AUC, adversarial shape"
    assert table.splitlines()[1].split() == ["coupe", "suv", "mean", "of", "baseline"]
    assert cells(table, "baseline") == ["0.800", "0.600", "0.700", "1.00"]
    assert cells(table, "adversarial") == ["0.400", "0.300", "0.350", "0.50"]
    assert cells(table, "lambda") == ["1", "1"]
    assert "random" not in table


def test_titles_name_an_edit_as_it_is_written() -> None:
    spec = AttackSpec(space="family", naturalness=95.0, search_scenes=3, edit="chassis.height_m:-1")
    rows = [auc_row("suv", "baseline", 0.5), auc_row("suv", "baseline", 0.5, search=spec.label)]
    _, edited = auc_tables(pd.DataFrame(rows))
    title = edited.splitlines()[0]
    assert title == "AUC, adversarial shape, search descent family within95 universal4 chassis.height_m:-1"


def test_data_sets_are_pooled_by_their_scores() -> None:
    rows = [auc_row("suv", "baseline", 0.5, scores=1), auc_row("suv", "baseline", 0.8, scores=2, dataset="kitti")]
    (table,) = auc_tables(pd.DataFrame(rows))
    assert cells(table, "baseline") == ["0.700", "0.700", "1.00"]


def test_shape_before_pose_and_a_table_for_each_variant() -> None:
    rows = [
        auc_row("suv", "baseline", 0.5, mode="pose", **{"lambda": None}),
        auc_row("suv", "baseline", 0.5, accuracy="paper"),
        auc_row("suv", "baseline", 0.5),
    ]
    titles = [table.splitlines()[0] for table in auc_tables(pd.DataFrame(rows))]
    assert titles == [
        "AUC, adversarial shape, accuracy paper",
        "AUC, adversarial shape, accuracy standard",
        "AUC, adversarial pose, accuracy standard",
    ]


def test_a_vehicle_without_a_score_is_a_dash() -> None:
    rows = [auc_row("coupe", "baseline", None, 0, selected=False), auc_row("suv", "baseline", 0.5)]
    (table,) = auc_tables(pd.DataFrame(rows))
    assert cells(table, "baseline") == ["-", "0.500", "0.500", "1.00"]


def test_long_names_are_cut_where_they_still_differ() -> None:
    names = ["sedan_119033fe083145e22f31600ac759c763", "sedan_119033fe083145e22f31699999999999", "suv"]
    (table,) = auc_tables(pd.DataFrame([auc_row(name, "baseline", 0.5) for name in names]))
    header = table.splitlines()[1].split()
    assert header[2] == "suv" and len(set(header[:2])) == 2
    assert all(name.startswith(cut.rstrip("~")) for name, cut in zip(names, header))


def test_a_table_for_each_detector_that_scores() -> None:
    rows = [auc_row("suv", "baseline", 0.5), auc_row("suv", "baseline", 0.7, scored_by="sst")]
    first, second = auc_tables(pd.DataFrame(rows))
    assert first.splitlines()[0] == "AUC, adversarial shape, scored by pointpillars"
    assert second.splitlines()[0] == "AUC, adversarial shape, scored by sst"
    assert cells(second, "baseline")[0] == "0.700"


def test_coverage_names_what_did_not_run() -> None:
    scores = pd.DataFrame(
        {"task_id": ["a", "a", "b"], "score": [0.5, 0.5, None], "status": ["ok", "ok", "no_placement"]}
    )
    attempts = pd.DataFrame(
        {
            "task_id": ["a", "b", "c"],
            "outcome": ["done", "done", "failed"],
            "quarantined": [False, False, True],
            "error": [None, None, "ValueError: no root"],
        }
    )
    assert coverage_lines(scores, attempts, planned=3) == [
        "1 of 3 tasks scored",
        "  1 without a score: no_placement",
        "  1 quarantined (tracebacks in final/attempts.parquet):",
        "    c  ValueError: no root",
    ]


def test_universal_shapes_that_were_searched_in_fewer_scenes_are_counted() -> None:
    search = ["descent", "descent_universal4", "descent_within95_universal4_chassis.height_m:-1"]
    scores = pd.DataFrame({"task_id": ["a", "b", "b", "c"], "search": [search[0], search[1], search[1], search[2]]})
    stages = ["render", "search_scenes", "search_scenes"]
    timings = pd.DataFrame({"task_id": ["b", "b", "c"], "stage": stages, "calls": [9, 1, 3]})
    assert missing_search_scenes(scores, timings) == (
        "1 of 2 universal shapes searched in fewer scenes than requested: "
        "2 of 6 other scenes had no room for the vehicle"
    )
    assert missing_search_scenes(scores, timings[timings["task_id"] == "c"]) == ""
    assert missing_search_scenes(scores, timings[:1]) == "", "no shape was universal"


def test_stage_times_are_means_over_tasks() -> None:
    scores = pd.DataFrame({"task_id": ["a", "b"], "mode": ["shape", "shape"]})
    timings = pd.DataFrame(
        {
            "task_id": ["a", "b", "a", "b"],
            "stage": ["render", "render", "total", "total"],
            "milliseconds": [30.0, 50.0, 100.0, 100.0],
            "calls": [2, 4, 1, 1],
        }
    )
    lines = str(stage_times(timings, scores)).splitlines()
    assert lines[-2].split() == ["shape", "total", "100", "100%", "1"]
    assert lines[-1].split() == ["shape", "render", "40", "40%", "3"]
