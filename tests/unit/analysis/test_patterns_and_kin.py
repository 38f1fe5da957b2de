"""Aggregated changes and retrieved kin: means, intervals and exclusions, on handmade tables."""

from __future__ import annotations

import base64
import json
import re
import types
from typing import Any

import numpy as np
import pandas as pd
import pytest
from analysed import blocks_html
from scipy.stats import t

from shift3d.analysis.html.sections.curves import thresholds
from shift3d.analysis.html.sections.patterns import patterns
from shift3d.analysis.html.sections.retrieval import kin_curves
from shift3d.analysis.mlflow.sweep import follow_up_metrics
from shift3d.analysis.results import with_effects_requested
from shift3d.analysis.tables.patterns import NAMES, pattern_groups, patterns_table
from shift3d.analysis.tables.retrieval import controls_of, kept, pool_table, pool_vehicle_of, retrieval_table
from shift3d.analysis.tables.stability import stability_table
from shift3d.errors import InputError
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.sweep.planning.tasks_builder import tasks_of
from shift3d.task.spec import TaskSpec

KNOWN = {"search": "descent", "lambda": 1.0, "alpha": 0.01, "detector": "pointpillars", "scored_by": "pointpillars"}
POSE = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")


def measured(changes: list[float], field: str = "height_cm") -> pd.DataFrame:
    """Return one shape task per scene, with a change of a single measure."""
    rows = []
    for number, change in enumerate(changes):
        same = KNOWN | {"mode": "shape", "task_id": f"t{number}", "dataset": "street", "scene": f"s{number}"}
        usual = dict.fromkeys(NAMES, 150.0)
        rows += [same | usual | {"method": "baseline"}, same | usual | {field: 150.0 + change, "method": "adversarial"}]
    return pd.DataFrame(rows)


def poses(after: dict[str, float], yaw: float) -> pd.DataFrame:
    at = dict(zip(POSE, (20.0, 5.0, -1.0, yaw, 0.0, 0.0)))
    same = KNOWN | {"mode": "pose", "task_id": "p", "dataset": "street", "scene": "s", "replicate": 0, "score": 0.5}
    moved = {name: value + after.get(name, 0.0) for name, value in at.items()}
    rows = [same | at | {"method": "baseline"}, same | moved | {"method": "adversarial"}]
    return pd.DataFrame([row | {"range_m": float(np.hypot(row["x_m"], row["y_m"]))} for row in rows])


def test_a_change_that_all_share_is_a_point_and_clear() -> None:
    ((label, found),) = pattern_groups(measured([-8.0] * 6), poses({}, 0.0).iloc[:0])
    assert label == "shape, descent, lambda 1, alpha 0.01, pointpillars"
    by_name = {pattern.name: pattern for pattern in found}
    height = by_name["height"]
    assert (height.change.mean, height.change.low, height.change.high) == pytest.approx((-8.0, -8.0, -8.0))
    assert (height.before, height.fell, height.rose, height.solutions, height.clear) == (150.0, 1.0, 0.0, 6, True)
    assert not by_name["length"].clear and by_name["length"].size == 0.0
    ((_, few),) = pattern_groups(measured([-8.0] * 5), poses({}, 0.0).iloc[:0])
    assert not any(pattern.clear for pattern in few) and "fewer than 6 scenes" in str(patterns_table("Changes", few))


def test_a_figure_of_changes_shows_where_none_is() -> None:
    """A change of 20 cm back and 10 cm to the right could, without 0 on the axis, pass for a move ahead."""
    moved = poses({"x_m": -0.2, "y_m": -0.1}, 0.0)
    sweep = types.SimpleNamespace(patterns=measured([0.0]).iloc[:0], scores=moved, solutions=moved)
    html = blocks_html(patterns(sweep))  # type: ignore[arg-type]
    assert "Mean change in centimetres" in html and '"rangemode":"tozero"' in html.replace(" ", "")


def test_what_differs_from_scene_to_scene_has_an_interval_around_its_mean() -> None:
    changes = [-9.0, 4.0, 2.0, -3.0, 7.0, 0.2, -1.2, 5.0]
    ((_, found),) = pattern_groups(measured(changes), poses({}, 0.0).iloc[:0])
    height = next(pattern for pattern in found if pattern.name == "height")
    assert height.change.mean == pytest.approx(np.mean(changes))
    assert height.change.low < height.change.mean < height.change.high
    assert height.size == pytest.approx(np.abs(changes).mean()) and not height.clear
    assert (height.fell, height.rose) == (3 / 8, 4 / 8)
    assert "+0.6 [" in str(patterns_table("Changes", found))


def test_a_measure_that_a_mesh_does_not_have_leaves_the_solution_out() -> None:
    rows = measured([5.0, 5.0, 5.0], "wheelbase_cm")
    rows.loc[1, "wheelbase_cm"] = np.nan
    ((_, found),) = pattern_groups(rows, poses({}, 0.0).iloc[:0])
    counts = {pattern.name: pattern.solutions for pattern in found}
    assert counts["wheelbase"] == 2 and counts["height"] == 3


def test_what_was_searched_under_other_effects_or_accuracies_has_a_line_of_its_own() -> None:
    plain, fog = measured([-8.0] * 6), measured([4.0] * 6).assign(accuracy="fast")
    fog["task_id"] = "fog-" + fog["task_id"]
    rows = pd.concat([plain.assign(accuracy="fast"), fog], ignore_index=True)
    effects = pd.Series([["fog"] if task.startswith("fog") else [] for task in rows["task_id"]])
    scores = rows.assign(effects=effects, replicate=0, score=0.5)
    found = dict(pattern_groups(rows, scores))
    changes = {label: next(p for p in own if p.name == "height").change.mean for label, own in found.items()}
    common = "shape, descent, lambda 1, alpha 0.01, pointpillars"
    assert changes == pytest.approx({f"{common}, no effects": -8.0, f"{common}, fog": 4.0})
    accuracies = rows.assign(accuracy=rows["task_id"].str.startswith("fog").map({True: "fast", False: "standard"}))
    assert set(dict(pattern_groups(accuracies, scores.iloc[:0]))) == {f"{common}, standard", f"{common}, fast"}

    kin = [
        retrieved(f"s{number}", "retrieved", score) | {"accuracy": accuracy, "task_id": f"{accuracy}{number}"}
        for accuracy, score in (("standard", 0.5), ("fast", 0.7))
        for number in range(6)
    ]
    table = retrieval_table(pd.DataFrame(kin))
    assert table is not None
    assert [(line[0].split(", ")[-1], dict(zip(table.header, line))["retrieved"]) for line in table.lines] == [
        ("standard", "0.500"),
        ("fast", "0.700"),
    ]
    assert [dict(zip(table.header, line))["controls"] for line in table.lines] == ["-", "-"], "there are none"


def test_kin_and_verified_solutions_of_two_settings_of_effects_have_a_line_for_each() -> None:
    """A scene in which both settings simulate the same has one task, which counts in both lines."""
    settings = [("none",), ("fog",), ("none", "fog")]
    specs = [TaskSpec("suv", f"s{n}", "street", "shape", 1.0, 0.01, "pointpillars", "standard") for n in range(3)]
    tasks = tasks_of(PlannedTask(spec, 0, requested) for spec, requested in zip(specs, settings))
    ids = dict(zip(("none", "fog", "both"), tasks.ids.to_pylist()))
    kin = [
        retrieved(name, "retrieved", score) | {"task_id": ids[name]}
        for name, score in (("none", 0.9), ("fog", 0.3), ("both", 0.6))
    ]
    table = retrieval_table(with_effects_requested(pd.DataFrame(kin), tasks))
    assert table is not None
    found = [(line[0].split(", ")[-1], dict(zip(table.header, line))["retrieved"]) for line in table.lines]
    assert found == [("no effects", "0.750"), ("fog", "0.450")]

    same = KNOWN | {"mode": "shape", "method": "adversarial", "accuracy": "standard", "score": 0.3, "robust": True}
    rows = [same | {"task_id": ids[name], "stable": name != "fog"} for name in ids]
    verified = pd.DataFrame(rows).assign(score_again=0.3, score_reference=0.3)
    lines = stability_table(with_effects_requested(verified, tasks)).lines
    found = [(line[0], f"{line[5]} of {line[4]}") for line in lines]
    assert found == [("adversarial, no effects", "0 of 2"), ("adversarial, fog", "1 of 2")]


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_a_pose_moves_in_the_vehicles_own_axes(yaw: float) -> None:
    forward, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    dx, dy = 1.2 * forward - 0.4 * left
    scores = poses({"x_m": dx, "y_m": dy, "yaw_rad": 2 * np.pi - 0.1, "pitch_rad": 0.05}, yaw)
    ((_, found),) = pattern_groups(measured([]).reindex(columns=[*KNOWN, "mode", "method"]), scores)
    means = {pattern.name: pattern.change.mean for pattern in found}
    assert means["forward"] == pytest.approx(120.0) and means["to the left"] == pytest.approx(-40.0)
    assert means["turned to the left"] == pytest.approx(-np.degrees(0.1))
    assert means["nose down"] == pytest.approx(np.degrees(0.05)) and means["left side up"] == 0.0


def retrieved(scene: str, role: str, score: float, excluded: bool = False, replicate: int = 0) -> dict[str, Any]:
    place = {"mode": "shape", "task_id": f"t-{scene}", "dataset": "street", "scene": scene, "vehicle": "suv"}
    pool = {"pool_dataset": "street", "pool_scene": f"pool-{scene}", "pool_label": replicate, "pool_score": score / 2}
    scores = {"score": score, "score_baseline": 0.8, "score_solution": 0.2}
    return KNOWN | place | pool | scores | {"role": role, "excluded": excluded, "replicate": replicate}


def test_kin_are_compared_with_the_mean_of_their_controls_and_the_excluded_are_left_out() -> None:
    rows = []
    for number in range(6):
        rows.append(retrieved(f"s{number}", "retrieved", 0.5))
        rows += [retrieved(f"s{number}", "control", 0.6 + 0.2 * draw, replicate=draw + 1) for draw in range(2)]
    rows.append(retrieved("far", "retrieved", 0.0, excluded=True))
    found = kept(pd.DataFrame(rows))
    assert len(found) == 6 and found["control"].tolist() == pytest.approx([0.7] * 6)
    table = retrieval_table(pd.DataFrame(rows))
    assert table is not None
    (line,) = table.lines
    cells = dict(zip(table.header, line))
    assert cells["near enough"] == "6 of 7" and cells["retrieved"] == "0.500" and cells["controls"] == "0.700"
    assert cells["retrieved less baseline"] == "-0.300 [-0.300, -0.300]"
    assert cells["retrieved less controls"] == "-0.200 [-0.200, -0.200]"
    assert cells["the same in the log"] == "-0.100 [-0.100, -0.100]"
    assert retrieval_table(pd.DataFrame(rows).iloc[:0]) is None
    nothing = retrieval_table(pd.DataFrame(rows).iloc[-1:])
    assert nothing is not None and "No vehicle of the pool is near enough" in nothing.title


def test_the_curve_of_controls_is_of_single_vehicles() -> None:
    """Two controls with scores of 0.6 and 0.8: one is found above 0.65; their mean would count as found."""
    rows = pd.DataFrame([
        retrieved(f"s{number}", role, score, replicate=replicate)
        for number in range(6)
        for role, score, replicate in (("retrieved", 0.5, 0), ("control", 0.6, 1), ("control", 0.8, 2))
    ])  # fmt: skip
    plot = kin_curves(kept(rows), controls_of(rows))
    curves = {trace["name"]: trace["y"] for trace in json.loads(plot.data)["data"] if "name" in trace}
    recall = np.frombuffer(base64.b64decode(curves["controls, 0.700"]["bdata"]), curves["controls, 0.700"]["dtype"])
    assert recall[np.searchsorted(thresholds(), (0.595, 0.65, 0.8))].tolist() == [1.0, 0.5, 0.0]
    assert {"baseline, 0.800", "adversarial, 0.200", "retrieved, 0.500"} <= curves.keys()


def test_kin_are_so_many_vehicles_however_many_shapes_they_are_the_nearest_to() -> None:
    """Twenty shapes in as many scenes have four vehicles as kin: certainty is that of four vehicles, not of twenty."""
    less = np.array([0.0, 0.1, 0.2, 0.3])
    rows = [
        retrieved(f"s{number}", "retrieved", 0.8 - less[number % 4]) | {"pool_scene": f"pool-{number % 4}"}
        for number in range(20)
    ]
    table = retrieval_table(pd.DataFrame(rows))
    assert table is not None
    cell = dict(zip(table.header, table.lines[0]))["retrieved less baseline"]
    mean, low, high = map(float, re.findall(r"[-+][0-9.]+", str(cell)))
    half = t.ppf(0.975, 3) * less.std(ddof=1) / 2
    assert mean == -0.15 and low <= mean - 0.9 * half and high >= mean + 0.9 * half


def test_vehicles_of_two_data_sets_are_two_whatever_their_scenes_are_called() -> None:
    rows = []
    for number, dataset in enumerate(("kitti", "openpcdet")):
        pair = (retrieved(f"s{number}", "retrieved", 0.2), retrieved(f"s{number}", "control", 0.6, replicate=1))
        there = {"pool_dataset": dataset, "pool_scene": "000000"}
        rows += [row | there | {"pool_score": row["score"] * (number + 1)} for row in pair]
    table = retrieval_table(pd.DataFrame(rows))
    assert table is not None
    in_log = dict(zip(table.header, table.lines[0]))["the same in the log"]
    assert in_log.startswith("-0.600 ["), "the mean of -0.4 and -0.8"
    usual = {"status": "fitted", "flags": [], "points": 50, "residual_cm": 1.0, "score": 0.5, "scene": "000000"}
    errors = {"shape_error_cm": 2.0, "mean_shape_error_cm": 6.0}
    pool = pool_table(pd.DataFrame([usual | errors | {"dataset": name} for name in ("kitti", "openpcdet")]))
    assert pool.title.startswith("Labelled vehicles of 2 scenes: 2 fitted")
    frame = pd.DataFrame([{"dataset": name, "scene": "000000", "label": 0} for name in ("kitti", "openpcdet")])
    row = {"pool_dataset": "openpcdet", "pool_scene": "000000", "pool_label": 0}
    assert pool_vehicle_of(frame, row)["dataset"] == "openpcdet"
    with pytest.raises(InputError, match="no vehicle 1 of openpcdet/000000"):
        pool_vehicle_of(frame, row | {"pool_label": 1})


def test_mlflow_shows_mean_changes_and_the_scores_of_kin_and_nothing_of_tables_that_are_missing() -> None:
    scores = poses({}, 0.0)
    kin = [retrieved("s", "retrieved", 0.5), retrieved("s", "control", 0.7, replicate=1)]
    tables = {"scores": scores, "patterns": measured([-8.0] * 3), "retrieved": pd.DataFrame(kin)}
    found = follow_up_metrics(tables)
    group = "shape_ descent_ lambda 1_ alpha 0.01_ pointpillars"
    assert found[f"patterns/{group}/height cm"] == pytest.approx(-8.0)
    scored = {"baseline": 0.8, "shape": 0.2, "retrieved": 0.5, "controls": 0.7}
    assert {name: found[f"retrieval/{group}/pointpillars/{name}"] for name in scored} == pytest.approx(scored)
    alone = follow_up_metrics({"scores": scores, "retrieved": pd.DataFrame(kin[:1])})
    assert [name.rsplit("/")[-1] for name in alone] == ["baseline", "shape", "retrieved"]  # no controls: no number
    assert follow_up_metrics({"scores": scores}) == {}


def test_a_pool_says_how_many_were_fitted_flagged_and_refused() -> None:
    usual = {
        "dataset": "street",
        "scene": "s",
        "status": "fitted",
        "flags": [],
        "points": 50,
        "residual_cm": 1.0,
        "score": 0.5,
    }
    errors = {"shape_error_cm": 2.0, "mean_shape_error_cm": 6.0}
    rows = [usual | errors, usual | {"flags": ["one_side"], "shape_error_cm": 4.0, "mean_shape_error_cm": 6.0}]
    rows.append(
        usual | {"status": "few_points", "residual_cm": None, "shape_error_cm": None, "mean_shape_error_cm": None}
    )
    table = pool_table(pd.DataFrame(rows))
    assert "2 fitted, 1 refused (few_points 1)" in table.title
    lines = {line[0]: line[1:] for line in table.lines}
    assert lines["all"][:4] == ["2", "1", "1.0", "3.0"] and lines["flagged one_side"][:2] == ["1", "0"]
