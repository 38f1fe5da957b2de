"""Figures of a finished sweep are those of its tables."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import valid_sweeps
from scripts.sweep_figures import _edits, _numbers, _rules, sweep_figures

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.tables.table import Table
from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.sweep.planning.tasks_builder import tasks_of
from shift3d.sweep.results.final import write_final

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return folder


@pytest.fixture(scope="module")
def sweep(folder: Path) -> Sweep:
    return read_sweep(folder)


def test_an_auc_is_the_mean_score_and_a_ratio_that_of_two(sweep: Sweep) -> None:
    found = sweep_figures(sweep)
    rows = sweep.scored[(sweep.scored["method"] == "adversarial") & (sweep.scored["vehicle"] == "suv")]
    ours = found["Adversarial shape/adversarial/suv"]
    assert ours["value"] == pytest.approx(rows["score"].mean()) and ours["n"] == len(rows)
    means = {method: found[f"Adversarial shape/{method}/mean"]["value"] for method in ("baseline", "adversarial")}
    ratio = found["Adversarial shape/adversarial/of baseline"]["value"]
    assert ratio == pytest.approx(means["adversarial"] / means["baseline"])
    assert "Adversarial shape/baseline/of baseline" not in found


def test_a_ratio_is_that_of_the_tasks_that_have_both(sweep: Sweep) -> None:
    """Random poses, for example, are missing at hard places."""
    rows = sweep.scores[sweep.scores["score"].notna()]
    lost, kept = rows["task_id"].unique()
    scores = rows.assign(score=rows["score"].where(rows["task_id"] != lost, 0.125))
    scores = scores[(scores["task_id"] == kept) | (scores["method"] != "random")]
    left = scores[scores["task_id"] == kept].groupby("method")["score"].mean()
    means = scores.groupby(["vehicle", "method"])["score"].mean()
    auc = sweep.auc.assign(auc=[means.get((v, m), 0.5) for v, m in zip(sweep.auc["vehicle"], sweep.auc["method"])])
    found = sweep_figures(dataclasses.replace(sweep, auc=auc, scores=scores))
    ratio = found["Adversarial shape/random/of baseline"]["value"]
    assert ratio == pytest.approx(left["random"] / left["baseline"])


def test_random_draws_are_as_natural_as_they_are_themselves(sweep: Sweep) -> None:
    """The adversarial shape's verdict does not apply to the best of the draws."""
    found = sweep.scores[(sweep.scores["method"] == "adversarial") & sweep.scores["score"].notna()]
    draws = found.assign(method="random_budget", natural=False)
    own = sweep.scores.assign(natural=sweep.scores["natural"].mask(sweep.scores["method"] == "adversarial", True))
    scores = pd.concat([own, draws], ignore_index=True)
    groups = sweep.auc[sweep.auc["method"] == "adversarial"].assign(method="random_budget")
    auc = pd.concat([sweep.auc, groups], ignore_index=True)
    values = sweep_figures(dataclasses.replace(sweep, scores=scores, auc=auc))
    assert (
        values["Adversarial shape/adversarial/natural"]["value"]
        == values["Adversarial shape/adversarial/natural"]["n"]
        > 0
    )
    assert values["Adversarial shape/random_budget/natural"]["value"] == 0


def test_how_much_was_run_is_said(sweep: Sweep) -> None:
    found = {name: one["value"] for name, one in sweep_figures(sweep).items()}
    assert (found["tasks"], found["tasks scored"], found["scenes"]) == (len(sweep.plan.tasks), 2, 2)


def test_the_fall_of_the_loss_is_that_of_the_last_quarter_below_the_first(sweep: Sweep) -> None:
    """The unchanged vehicle is no step, and a search that ends early keeps its last loss."""
    one = sweep.scored.drop_duplicates("task_id")[["task_id", "dataset", "scene", "vehicle"]]
    losses = [50.0, 9.0, 7.0, 5.0, 4.0, 4.0, 4.0, 3.0, 1.0]
    steps = [one.assign(step=step, loss=loss) for step, loss in enumerate(losses)]
    early = pd.concat([*steps[:7], *(rows.iloc[:-1] for rows in steps[7:])], ignore_index=True)
    falls = [-(8.0 - 2.0)] * (len(one) - 1) + [-(8.0 - 4.0)]
    name = "Adversarial shape/adversarial/loss, last quarter less first"
    found = sweep_figures(dataclasses.replace(sweep, trajectories=early))[name]
    assert found["value"] == pytest.approx(sum(falls) / len(falls)) and found["n"] == len(one) > 1
    low, high = found["interval"]
    assert min(falls) <= low < high <= max(falls)


def test_other_places_are_counted_by_their_cells(sweep: Sweep) -> None:
    keys = ["sweep", "dataset", "vehicle", "mode", "lambda", "alpha", "detector", "accuracy", "search", "effects"]
    own = sweep.auc[(sweep.auc["method"] == "adversarial") & sweep.auc["selected"]].iloc[:1]
    grid = pd.concat([own[[*keys, "scored_by", "method"]]] * 3, ignore_index=True).assign(
        cell_x_m=[0.0, 10.0, 20.0], cell_y_m=0.0, cell_size_m=10.0, scores=[6, 1, 5], mean_reduction=[0.3, -0.1, 0.2]
    )
    found = sweep_figures(dataclasses.replace(sweep, bev_transfer=grid))
    values = [found[name]["value"] for name in ("placements", "cells", "cells with a fall", "cells with five or more")]
    assert values == [12, 3, 2, 2] and found["of these with a fall"]["n"] == 2


def test_what_was_verified_is_counted_over_the_attacked_detectors_solutions(sweep: Sweep) -> None:
    base = {
        "method": "adversarial",
        "scored_by": "p",
        "detector": "p",
        "score": 0.3,
        "score_again": 0.3,
        "robust": True,
    }
    counts = {"missed_hits": 1, "wrong_surface": 0, "hits_reference": 300, "unresolved_beams": 2}
    rows = [
        base | counts | {"score_reference": 0.31, "stable": True},
        base | counts | {"score_reference": 0.40, "stable": False},
        base | counts | {"score_reference": 0.90, "stable": False, "scored_by": "another"},
        base | counts | {"score_reference": 0.90, "stable": False, "method": "baseline"},
    ]
    found = sweep_figures(dataclasses.replace(sweep, verification=pd.DataFrame(rows)))
    values = {name.removeprefix("verified/"): one["value"] for name, one in found.items() if "verified/" in name}
    assert (values["stable"], values["within 0.02"], values["robust"], values["same again"]) == (1, 1, 2, 2)
    assert (values["hits"], values["missed_hits"], values["unresolved"]) == (600, 2, 4)
    assert values["largest change"] == pytest.approx(0.1) and found["verified/stable"]["n"] == 2


def test_an_edit_is_judged_against_the_other_end_of_its_range_at_the_same_place(sweep: Sweep) -> None:
    row = sweep.scores[sweep.scores["score"].notna()].iloc[0].to_dict() | {"method": "edited", "vehicle": "van"}
    ends = [("low", 0.8, "a"), ("high", 0.5, "a"), ("low", 0.6, "b"), ("high", 0.6, "b"), ("low", 0.9, "alone")]
    scores = pd.DataFrame([row | {"search": f"edit {end}", "score": score, "scene": at} for end, score, at in ends])
    sizes = pd.DataFrame(
        [{"task_id": row["task_id"], "method": "edited", "length_m": 5.0, "height_m": 1.9, "width_m": 2.1}]
    )
    found = dict(_edits(dataclasses.replace(sweep, scores=scores, shapes=sizes)))
    label = f"edits/van {row['scored_by']}"
    change = found[f"{label}/change"]
    assert change["value"] == pytest.approx(-0.15) and change["n"] == 2, "a place with one end does not count"
    assert change["interval"] == pytest.approx((-0.3, 0.0))
    assert [found[f"{label}/score {end}"]["value"] for end in (0, 1)] == pytest.approx([0.7, 0.55])
    assert (found[f"{label}/height_m 1"]["value"], found[f"{label}/width_m 0"]["value"]) == (1.9, 2.1)


def test_a_rule_is_written_with_what_it_takes_in_each_group(sweep: Sweep) -> None:
    """Vehicles over 2 m score 0.4 less, in every scene and for every vehicle."""
    row = sweep.scores[sweep.scores["score"].notna()].iloc[0].to_dict() | {"method": "baseline", "mode": "shape"}
    row |= {"detector": row["scored_by"]}
    spec = sweep.plan.tasks[0].spec
    specs = [dataclasses.replace(spec, vehicle=f"v{v}", scene=f"s{s}") for v in range(4) for s in range(8)]
    tall = [({"task_id": one.task_id, "replicate": r}, one, r % 2) for one in specs for r in range(4)]
    objects = [row | known | {"vehicle": one.vehicle, "scene": one.scene} for known, one, _ in tall]
    scores = pd.DataFrame(objects).assign(score=[0.8 - 0.4 * t for *_, t in tall])
    sizes = {"length_m": 4.0, "width_m": 1.8, "clearance_m": 0.2, "method": "baseline"}
    shapes = pd.DataFrame([known | {"height_m": 1.5 + t} for known, _, t in tall]).assign(**sizes)
    tasks = tasks_of(PlannedTask(one, 0, ("none",)) for one in specs)
    plan = dataclasses.replace(sweep.plan, sweep="failure_rules", tasks=tasks)
    found = dict(_rules(dataclasses.replace(sweep, plan=plan, scores=scores, shapes=shapes)))
    values = {name: one["value"] for name, one in found.items() if name.startswith("rule/")}
    assert values["rule/height over 200 cm/other vehicles"] == pytest.approx(-0.4)
    assert values["rule/height over 200 cm/other scenes"] == pytest.approx(-0.4)


def test_numbers_of_a_printed_table_keep_their_intervals() -> None:
    line = ["shape", "sst", "12 of 20", "0.53 [0.48, 0.57]", "-", "1,234", ("0.25", "[0.1, 0.4]")]
    table = Table("A title", ["", "by", "near", "ratio", "none", "points", "noted"], [line])
    found = dict(_numbers("kin", table, named_by=2))
    values = {name.removeprefix("kin/shape sst/"): one["value"] for name, one in found.items()}
    assert values == {"near": 12, "ratio": 0.53, "points": 1234, "noted": 0.25}
    assert found["kin/shape sst/ratio"]["interval"] == (0.48, 0.57) and found["kin/shape sst/noted"]["interval"]
    assert dict(_numbers("kin", None)) == {}


def test_the_command_writes_what_it_prints(folder: Path, tmp_path: Path) -> None:
    script = ROOT / "docs" / "scripts" / "sweep_figures.py"
    words = [sys.executable, str(script), str(folder), f"json={tmp_path / 'f.json'}"]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout) == json.loads((tmp_path / "f.json").read_text())
