"""The paragraph on what accuracy cost says what the frames hold."""

from pathlib import Path
from typing import Any

import pandas as pd

from shift3d.analysis.tables.accuracy_cost import LADDER, MEASURED, accuracy_cost, measured_presets


def score(task: str, method: str, accuracy: str = "standard", **audit: Any) -> dict[str, Any]:
    names = ("audited_beams", "audited_hits", "missed_hits", "false_hits", "wrong_surface", "depth_error_max_m")
    row = {"task_id": task, "method": method, "replicate": 0, "accuracy": accuracy, "scored_by": "pointpillars"}
    return {**row, **dict.fromkeys(names), **audit}


def timing(task: str, stage: str, milliseconds: float) -> dict[str, Any]:
    return {"task_id": task, "method": "adversarial", "stage": stage, "milliseconds": milliseconds, "calls": 1}


def preset(name: str, ms: float, p99: float, lost: float, step: float | None = None) -> dict[str, Any]:
    row = {"preset": name, "ms_median": ms, "depth_p99_m": p99, "missed_hits": lost, "false_hits": 0.0}
    return {**row, "wrong_surface": 0.0, "step_ms_median": step}


PRESETS = pd.DataFrame(
    [preset("draft", 50.0, 4e-3, 0.02), preset("standard", 100.0, 5e-5, 0.0001), preset("reference", 3000.0, 0.0, 0.0)]
).set_index("preset")
CLEAN = {"audited_beams": 64, "audited_hits": 32, "missed_hits": 0, "false_hits": 0, "wrong_surface": 0}


def test_audits_are_summed_each_object_once() -> None:
    rows = [
        score("a", "baseline", **CLEAN, depth_error_max_m=1e-4),
        score("a", "baseline", **CLEAN, depth_error_max_m=1e-4) | {"scored_by": "sst"},
        score("a", "adversarial", **{**CLEAN, "missed_hits": 2, "wrong_surface": 1}, depth_error_max_m=3e-4),
        score("a", "random"),
    ]
    text = accuracy_cost(pd.DataFrame(rows), pd.DataFrame([timing("a", "total", 2000.0)]), PRESETS, "a frontier")
    assert "standard: 128 beams of 2 objects" in text
    assert "of 64 true hits 2 missed, 1 on another surface, 0 false; depth error at most 0.3 mm" in text


def test_time_is_that_of_the_presets_own_tasks() -> None:
    rows = [score("a", "baseline"), score("b", "baseline", "draft")]
    times = [timing("a", "total", 4000.0), timing("a", "render", 1000.0), timing("b", "total", 1000.0)]
    draft, standard = (
        next(
            line
            for line in accuracy_cost(pd.DataFrame(rows), pd.DataFrame(times), PRESETS, "x").splitlines()
            if start in line
        )
        for start in ("draft:", "standard:")
    )
    assert "A task took 4.0 s: render 25%." in standard
    assert "A task took 1.0 s" in draft and "no beam was audited" in draft


def test_the_next_preset_up_and_down() -> None:
    text = accuracy_cost(
        pd.DataFrame([score("a", "baseline")]), pd.DataFrame([timing("a", "total", 1.0)]), PRESETS, "x"
    )
    assert "draft would take 0.5 x the rendering time: depth error p99 4 mm for 0.05 mm" in text
    assert "hits lost or wrong 2.00% for 0.01%" in text
    assert "reference would take 30 x the rendering time" in text
    only_up = accuracy_cost(
        pd.DataFrame([score("a", "baseline", "draft")]), pd.DataFrame([timing("a", "total", 1.0)]), PRESETS, "x"
    )
    assert "standard would take 2 x" in only_up and "reference" not in only_up


def test_without_a_frontier_of_ones_own_the_shipped_one_speaks(tmp_path: Path) -> None:
    presets, whose = measured_presets(tmp_path)
    assert set(LADDER) <= set(presets.index) and "ships" in whose
    assert MEASURED.is_file()
    assert presets.loc["draft", "ms_median"] < presets.loc["reference", "ms_median"]
