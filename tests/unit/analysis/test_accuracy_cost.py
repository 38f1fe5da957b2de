"""Measured and expected cost of accuracy equals the values in the frames."""

from pathlib import Path
from typing import Any

import pandas as pd
from frontier_by_hand import flagged, frontier_row

from shift3d.analysis.tables.accuracy.cost import (
    MEASURED,
    accuracy_cost,
    diagnostics,
    measured_presets,
    preset_meanings,
    preset_table,
)
from shift3d.analysis.tables.accuracy.frontier import legend
from shift3d.store.frontier_table import frontier_table
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.store.tables import write_table


def score(task: str, method: str, accuracy: str = "standard", **audit: Any) -> dict[str, Any]:
    names = ("audited_beams", "audited_hits", "missed_hits", "false_hits", "wrong_surface", "depth_error_max_m")
    row = {"task_id": task, "method": method, "replicate": 0, "accuracy": accuracy, "scored_by": "pointpillars"}
    place = {"dataset": "street", "scene": task, "vehicle": "suv", "detector": "pointpillars", "effects": ["ray_drop"]}
    return {**row, **place, **dict.fromkeys(POSE_COLUMNS, 0.0), **dict.fromkeys(names), **audit}


def timing(task: str, stage: str, milliseconds: float) -> dict[str, Any]:
    return {"task_id": task, "method": "adversarial", "stage": stage, "milliseconds": milliseconds, "calls": 1}


CLEAN = {"audited_beams": 64, "audited_hits": 32, "missed_hits": 0, "false_hits": 0, "wrong_surface": 0}


def test_audits_are_summed_each_object_once() -> None:
    rows = [
        score("a", "baseline", **CLEAN, depth_error_max_m=1e-4),
        score("a", "baseline", **CLEAN, depth_error_max_m=1e-4) | {"scored_by": "sst"},
        score("a", "adversarial", **{**CLEAN, "missed_hits": 2, "wrong_surface": 1}, depth_error_max_m=3e-4),
        score("a", "random"),
    ]
    (text,) = accuracy_cost(pd.DataFrame(rows), pd.DataFrame([timing("a", "total", 2000.0)]))
    assert "standard: 128 beams of 2 objects" in text
    assert "of 64 true hits, 2 missed and 1 on another surface; 0 false hits; depth error at most 0.3 mm" in text


def test_a_baseline_that_tasks_share_is_one_object() -> None:
    """Shape and pose tasks have the same place: the unchanged vehicle was audited for the first task."""
    audited = {**CLEAN, "depth_error_max_m": 1e-4, "max_residual_m": 1e-6, "unresolved_beams": 1, "non_finite": 0}
    audited |= {"grazing_gradient": None, "least_slope": None}
    found = [score(task, method, **audited) for task in "ab" for method in ("adversarial", "baseline")]
    same = pd.DataFrame(found).assign(scene="one")  # a shape search does not change the pose
    (text,) = accuracy_cost(same, pd.DataFrame([timing("a", "total", 2000.0)]))
    assert "standard: 192 beams of 3 objects rendered again at reference accuracy: of 96 true hits" in text
    assert "3 unresolved beams" in diagnostics(same) and "over 3 objects" in diagnostics(same)
    elsewhere = same.assign(x_m=[0.0, 0.0, 1.0, 1.0])
    assert "4 objects" in accuracy_cost(elsewhere, pd.DataFrame([timing("a", "total", 2000.0)]))[0]


def test_time_is_that_of_the_presets_own_tasks() -> None:
    rows = [score("a", "baseline"), score("b", "baseline", "draft")]
    spent = {"total": 4000.0, "render": 1000.0, "scored_by_sst": 2200.0, "audit": 3.0, "naturalness": 297.0}
    times = [*(timing("a", stage, took) for stage, took in spent.items()), timing("b", "total", 1000.0)]
    draft, standard = accuracy_cost(pd.DataFrame(rows), pd.DataFrame(times))
    assert "A task took 4.0 s: scored by sst 55%, render 25%, naturalness 7%, other 13%." in standard
    assert "A task took 1.0 s: other 100%." in draft and "the audit rendered no beam" in draft


def test_without_a_frontier_of_ones_own_the_shipped_one_speaks(tmp_path: Path) -> None:
    presets, whose = measured_presets(tmp_path)
    assert {"draft", "standard", "paper", "reference"} == set(presets.index) and "shipped" in whose
    assert MEASURED.is_file()
    assert presets.loc["draft", "ms_median"] < presets.loc["reference", "ms_median"]


def test_other_presets_stand_in_a_table_with_what_they_lose(tmp_path: Path) -> None:
    measured = [
        frontier_row("standard", 2.0, preset="standard", missed_hits=0.001),
        frontier_row("paper", 800.0, preset="paper"),
        *(frontier_row(name, 9.0, preset=name) for name in ("draft", "reference")),
    ]
    write_table(tmp_path / "frontier.parquet", frontier_table(flagged(measured)))
    table = preset_table(tmp_path)
    assert "this machine's frontier" in table.title
    rows = {str(line[0]): dict(zip(table.header, line)) for line in table.lines}
    assert rows["standard"]["time"] == "2 ms" and rows["standard"]["missed"] == "0.1 %"
    assert rows["standard"]["x paper"] == "400" and rows["paper"]["missed"] == "0"


def test_every_column_of_the_presets_is_explained_by_itself(tmp_path: Path) -> None:
    explained = preset_meanings()
    assert list(explained) == list(preset_table(tmp_path).header[1:])
    assert not any("the same" in meaning or "below" in meaning for meaning in explained.values())
    assert "time: median time of one rendering; x paper: " in legend(explained)


def test_a_frontier_of_other_scenes_or_one_that_is_torn_counts_as_none(tmp_path: Path) -> None:
    names = ("draft", "standard", "paper", "reference")
    kitti = [frontier_row(name, 9.0, preset=name, scenes="kitti") for name in names]
    write_table(tmp_path / "frontier.parquet", frontier_table(flagged(kitti)))
    assert "shipped" in measured_presets(tmp_path)[1] and set(measured_presets(tmp_path)[0].index) == set(names)
    (tmp_path / "frontier.parquet").write_bytes(b"PAR1")
    whose = measured_presets(tmp_path)[1]
    assert "shipped" in whose and f"{tmp_path / 'frontier.parquet'} cannot be read" in whose


def test_non_finite_values_are_those_of_an_object_whoever_scores_it() -> None:
    numerics = {"max_residual_m": 1e-6, "unresolved_beams": 0, "grazing_gradient": None, "least_slope": 0.5}
    rows = [score("a", "baseline", **numerics, non_finite=5) | {"scored_by": name} for name in ("one", "two")]
    assert "5 non-finite values" in diagnostics(pd.DataFrame(rows))
