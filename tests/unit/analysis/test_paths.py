"""Paths of the score: their mean and band, and the message for folders without paths."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import valid_sweeps
from analysed import blocks_html

from shift3d.analysis.html.sections.paths import case_path, mean_path, paths
from shift3d.analysis.results import read_sweep
from shift3d.analysis.variants import variants
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import table_from_rows
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final


def path_rows(scores: dict[str, list[float | None]]) -> pd.DataFrame:
    """Return rows by task, one task per scene; the second step is kept, the third breaks a constraint."""
    rows = [
        {"task_id": task, "place": f"street/{task}", "step": step, "proposal_score": score, "kept": step == 1}
        | {"valid": step != 2}
        for task, values in scores.items()
        for step, score in enumerate(values)
    ]
    return pd.DataFrame(rows)


def test_the_mean_path_is_the_mean_and_its_band_holds_it() -> None:
    rng = np.random.default_rng(3)
    scores = rng.random((12, 5))
    steps, mean, low, high = mean_path(path_rows({f"t{i}": list(row) for i, row in enumerate(scores)}))
    assert steps.tolist() == [0, 1, 2, 3, 4]
    assert mean == pytest.approx(scores.mean(axis=0))
    assert (low <= mean).all() and (mean <= high).all() and (high - low).min() > 0.1


def test_a_search_that_ended_early_stays_at_its_last_score() -> None:
    _, mean, low, _ = mean_path(path_rows({"a": [0.8, 0.4, 0.2], "b": [0.6, 0.2]}))
    assert mean == pytest.approx([0.7, 0.3, 0.2]) and low is not None
    assert mean_path(path_rows({"a": [0.8, 0.4]}))[2] is None


def test_the_best_step_of_a_case_is_named_and_marked() -> None:
    shown = blocks_html([case_path("case-1", path_rows({"a": [0.8, 0.4, 0.2]}))])
    assert "0.80 at the start; step 1 is the best" in shown and "breaks a constraint" in shown
    assert "stored no scores" in blocks_html([case_path("case-1", path_rows({"a": [None, None]}))])


@pytest.mark.parametrize("last", [1, 2, 5, 9])
def test_the_axis_of_few_steps_has_a_tick_at_each_step_and_none_between(last: int) -> None:
    shown = blocks_html([case_path("case-1", path_rows({"a": [0.8] * (last + 1)}))])
    assert '"dtick":1' in shown.replace(" ", "")


def test_folders_with_and_without_paths(tmp_path: Path) -> None:
    """A folder without paths is read; a folder with paths is drawn from its final table."""
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        valid_sweeps.write_sweep(folder)
    plan, log = read_plan(new), CommitLog(new, read_plan(new).spec_hash)
    rows = []
    for task in plan.tasks:
        spec = task.spec
        same = {name: getattr(spec, name) for name in ("task_id", "vehicle", "scene", "dataset", "mode", "alpha",
                                                       "detector", "accuracy", "search")}  # fmt: skip
        pose = dict.fromkeys(("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad"), 1.0)
        for step in range(3):
            found = {"step": step, "kept": step == 2, "proposal_score": 0.9 - 0.25 * step, "loss": 1.0}
            more = {"adversarial_loss": 1.0, "latent_distance": 0.1 * step, "object_points": 400, "valid": True}
            rows.append(same | pose | found | more | {"lambda": spec.lambda_, "sweep": plan.sweep})
    log.commit((), (), {"trajectories": table_from_rows("trajectories", rows)})
    for folder in (old, new):
        write_final(folder, plan, read_log(folder))
    (old / "final" / "trajectories.parquet").unlink()
    for folder, message in ((old, "stored no scores of search steps"), (new, "0.900 → 0.400 in 2 steps")):
        sweep = read_sweep(folder)
        shown = blocks_html(paths(sweep, variants(sweep.auc, sweep.scored)))
        assert message in shown
    other = [dataclasses.replace(variant, scored_by="sst") for variant in variants(sweep.auc, sweep.scored)]
    assert "stored no scores" in blocks_html(paths(sweep, other))
