"""The page of experiments: its numbers are those of the tables, and the paper's stand beside them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pandas as pd
import pytest
import valid_sweeps
from scripts.experiments import experiments

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.tables.paper import paper_table
from shift3d.store.log import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    folder = tmp_path_factory.mktemp("experiments") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return read_sweep(folder)


def cells(page: str, first: str) -> list[str]:
    """The cells of the table row that starts with this, emphasis taken off."""
    (line,) = (line for line in page.splitlines() if line.replace("*", "").startswith(f"| {first} |"))
    return [cell.strip(" *") for cell in line.strip("|").split("|")]


def test_an_auc_is_the_mean_score_and_the_papers_stands_below(sweep: Sweep) -> None:
    page = experiments([sweep])
    rows = sweep.scored[(sweep.scored["method"] == "adversarial") & (sweep.scored["vehicle"] == "suv")]
    ours, papers = cells(page, "adversarial"), cells(page, "adversarial, paper")
    assert ours[1] == f"{rows['score'].mean():.3f}" and ours[2].startswith(ours[1])
    paper = paper_table("shape", "pointpillars", "pointpillars")
    assert paper is not None and papers[1] == f"{paper.aucs.of('adversarial', 'suv'):.3f}"
    assert cells(page, "baseline, paper")[-1] == "1.00"


def test_a_section_says_what_was_run_and_sweeps_keep_their_order(sweep: Sweep) -> None:
    other = dataclasses.replace(sweep, plan=dataclasses.replace(sweep.plan, sweep="another"))
    page = experiments([sweep, other])
    assert page.index(f"## `{sweep.plan.sweep}`") < page.index("## `another`")
    assert page.count(f"{len(sweep.plan.tasks)} tasks (2 scored), 2 scenes") == 2
    assert Path.home().as_posix() not in page


def test_an_attack_run_again_with_other_settings_has_them_in_its_heading(sweep: Sweep) -> None:
    given = ("size=small", "attack.selection_window=1", "attack.noise_replicates=2", "out=elsewhere")
    again = dataclasses.replace(sweep, plan=dataclasses.replace(sweep.plan, overrides=given))
    headings = [line for line in experiments([sweep, again]).splitlines() if line.startswith("## ")]
    assert headings == [f"## `{sweep.plan.sweep}`", f"## `{sweep.plan.sweep}`, `attack.selection_window=1`"]
    assert experiments([again]).count("## ") == 1 and "steady" not in experiments([again]).split("Given")[0]


def test_other_places_are_counted_by_their_cells(sweep: Sweep) -> None:
    keys = [
        "sweep",
        "dataset",
        "vehicle",
        "mode",
        "lambda",
        "alpha",
        "detector",
        "accuracy",
        "search",
        "effects",
        "scored_by",
    ]
    own = sweep.auc[(sweep.auc["method"] == "adversarial") & sweep.auc["selected"]].iloc[:1][[*keys, "method"]]
    grid = pd.concat([own] * 3, ignore_index=True).assign(
        cell_x_m=[0.0, 10.0, 20.0], cell_y_m=0.0, cell_size_m=10.0, scores=[6, 1, 5], mean_reduction=[0.3, -0.1, 0.2]
    )
    page = experiments([dataclasses.replace(sweep, bev_transfer=grid)])
    assert "12 placements in 3 cells of 10 m; the score falls in 2 of them (67%)" in page
    assert "of the 2 cells with five or more, in 2." in page
