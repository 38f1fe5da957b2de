"""A real sqlite MLflow: a run per sweep, a child run per group, updated in place; never fails the sweep."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from shift3d.analysis.mlflow import sweep_groups
from shift3d.analysis.mlflow.client import share_view, shared_views
from shift3d.analysis.mlflow.sweep import SweepRecord, mirror
from shift3d.analysis.mlflow.sweep_groups import overall_metrics
from shift3d.evaluation.recall_curve import recall_curve

SAME = {"sweep": "default", "dataset": "street", "mode": "shape", "alpha": 0.01, "detector": "p", "scored_by": "p"}
SAME |= {"accuracy": "standard", "search": "descent", "effects": "auto"}
ROWS = [
    ("coupe", "baseline", 1.0, [0.7, 0.9], True),
    ("coupe", "adversarial", 1.0, [0.25, 0.55], True),
    ("coupe", "adversarial", 10.0, [0.9], False),
    ("suv", "adversarial", 1.0, [0.2], True),
    ("suv", "baseline", None, [], True),
]


def record(folder: Path, rows: list[Any] = ROWS, **counts: float) -> SweepRecord:
    (folder / "final").mkdir(parents=True, exist_ok=True)
    (folder / "final" / "scores.parquet").write_bytes(repr(rows).encode())
    for name in ("spec.yaml", "env.json", "plan.parquet"):
        (folder / name).touch()
    settings = {"attack": {"steps": 40}, "axes": {"vehicle": ["coupe", "suv"]}}
    return SweepRecord("default", "0123", folder, settings, *record_frames(rows), {"tasks_done": 60, **counts})


def record_frames(rows: list[Any]) -> tuple[pd.DataFrame, pd.DataFrame]:
    auc, curves = [], []
    for vehicle, method, weight, scores, selected in rows:
        group = {**SAME, "vehicle": vehicle, "method": method, "lambda": weight}
        mean = float(np.mean(scores)) if scores else None
        known = {"scores": len(scores), "tasks_scored": len(scores), "tasks_planned": 2, "mean_latent_distance": None}
        auc.append({**group, "auc": mean, **known, "mean_adversarial_loss": 0.5, "selected": selected})
        if scores:
            curve = recall_curve(scores)
            curves += [
                {**group, "score_threshold": t, "recall": r} for t, r in zip(curve.score_threshold, curve.recall)
            ]
    return pd.DataFrame(auc), pd.DataFrame(curves)


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A store that MLflow makes itself, with the sweep in it; tests only read it."""
    folder = tmp_path_factory.mktemp("mirrored")
    uri = f"sqlite:///{folder / 'mlflow.db'}"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # MLflow puts artifacts of a sqlite store into ./mlruns
        assert mirror(record(folder / "out"), uri, "shift3d") is None
    return uri


def runs_in(uri: str) -> tuple[Any, Any, dict[str, Any]]:
    """Return (client, the sweep's run, its group runs by name)."""
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("shift3d")
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id])
    (parent,) = [run for run in runs if "mlflow.parentRunId" not in run.data.tags]
    children = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert len(children) == len(runs) - 1
    by_name = {run.info.run_name: run for run in children}
    assert len(by_name) == len(children), "no group twice"
    return client, parent, by_name


def curve_of(client: Any, run: Any, name: str) -> dict[int, float]:
    points = client.get_metric_history(run.info.run_id, name)
    assert len({point.step for point in points}) == len(points), "no point twice"
    return {point.step: point.value for point in points}


def test_a_run_with_aucs_curves_settings_and_files_and_a_run_a_group(mirrored: str) -> None:
    client, run, groups = runs_in(mirrored)
    assert run.info.status == "FINISHED" and run.info.run_name == "default-0123"
    aucs = {name: value for name, value in run.data.metrics.items() if not name.startswith("recall/")}
    # To the digit: a mean of 0.4 and 0.2 is shown as 0.3.
    assert aucs == {
        "auc/shape/coupe/baseline": 0.8,
        "auc/shape/coupe/adversarial": 0.4,
        "auc/shape/suv/adversarial": 0.2,
        "shape/baseline": 0.8,
        "shape/adversarial": 0.3,
        "tasks_done": 60.0,
    }
    assert run.data.params["attack.steps"] == "40" and run.data.params["axes.vehicle"] == "['coupe', 'suv']"
    assert [file.path for file in client.list_artifacts(run.info.run_id, "final")] == ["final/scores.parquet"]
    assert "auc.csv" in {file.path for file in client.list_artifacts(run.info.run_id)}
    assert set(groups) == {
        "shape/coupe/baseline/lambda=1",
        "shape/coupe/adversarial/lambda=1",
        "shape/coupe/adversarial/lambda=10",
        "shape/suv/adversarial/lambda=1",
        "shape/suv/baseline/lambda=-",
    }
    group = groups["shape/coupe/adversarial/lambda=10"]
    assert group.info.status == "FINISHED" and group.data.metrics["auc"] == 0.9
    assert (group.data.params["selected"], group.data.params["lambda"]) == ("False", "10")
    assert "auc" not in groups["shape/suv/baseline/lambda=-"].data.metrics


def test_the_attacked_detectors_own_auc_has_one_name_whatever_other_detectors_score() -> None:
    """Two runs can be compared only by metrics of one name."""
    own = record_frames([("suv", "adversarial", 1.0, [0.2, 0.4], True)])
    other = [frame.assign(scored_by="q") for frame in record_frames([("suv", "adversarial", 1.0, [0.9], True)])]
    alone, curves = overall_metrics(*own)
    both, more = overall_metrics(*(pd.concat(pair) for pair in zip(own, other)))
    assert set(alone) == {"auc/shape/suv/adversarial", "shape/adversarial"}
    assert {name: both[name] for name in alone} == alone and both["shape/adversarial/q"] == 0.9
    assert set(more) == {*curves, "recall/shape/adversarial/q"}


def test_names_beyond_mlflows_limit_are_shortened_and_stay_distinct(tmp_path: Path, uri: str) -> None:
    vehicles = ["v" * 240 + end for end in ("_short", "_long")]
    rows = [(name, "baseline", 1.0, [score], True) for name, score in zip(vehicles, (0.25, 0.75))]
    assert mirror(record(tmp_path / "out", rows), uri, "shift3d") is None
    metrics = runs_in(uri)[1].data.metrics
    assert sorted(value for name, value in metrics.items() if name.startswith("auc/shape/v")) == [0.25, 0.75]


def test_curves_are_recall_over_the_threshold_in_percent(mirrored: str) -> None:
    client, run, groups = runs_in(mirrored)
    curve = curve_of(client, groups["shape/coupe/adversarial/lambda=1"], "recall")
    # Scores 0.25 and 0.55, and a detection has a score GREATER than the threshold.
    assert curve == {percent: 1.0 if percent < 25 else 0.5 if percent < 55 else 0.0 for percent in range(101)}
    mean = curve_of(client, run, "recall/shape/adversarial")
    assert [mean[percent] for percent in (0, 19, 20, 24, 25, 54, 55)] == [1.0, 1.0, 0.5, 0.5, 0.25, 0.25, 0.0]


def test_the_scores_are_a_dataset_with_the_digest_of_their_content(mirrored: str) -> None:
    (first,) = runs_in(mirrored)[1].inputs.dataset_inputs
    assert first.dataset.name == "default-scores" and len(first.dataset.digest) == 32


def test_the_same_sweep_again_is_written_in_place(tmp_path: Path, uri: str) -> None:
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    _, before, groups = runs_in(uri)
    assert mirror(record(tmp_path / "out", tasks_done=59, solutions_verified=3), uri, "shift3d") is None
    client, after, again = runs_in(uri)
    assert after.info.run_id == before.info.run_id
    assert {run.info.run_id for run in again.values()} == {run.info.run_id for run in groups.values()}
    assert (after.data.metrics["tasks_done"], after.data.metrics["solutions_verified"]) == (59.0, 3.0)
    assert len(curve_of(client, after, "recall/shape/adversarial")) == 101
    assert len(after.inputs.dataset_inputs) == 1


def test_a_mirror_that_was_cut_short_is_completed(tmp_path: Path, uri: str) -> None:
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    client, _, groups = runs_in(uri)
    gone, half = groups["shape/suv/adversarial/lambda=1"], groups["shape/coupe/baseline/lambda=1"]
    client.delete_run(gone.info.run_id)
    client.update_run(half.info.run_id, status="RUNNING")
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    client, _, again = runs_in(uri)
    assert set(again) == set(groups)
    assert again["shape/coupe/baseline/lambda=1"].info.run_id == half.info.run_id
    assert all(run.info.status == "FINISHED" for run in again.values())
    assert len(curve_of(client, again["shape/coupe/baseline/lambda=1"], "recall")) == 101


def test_other_scores_of_the_same_spec_replace_the_run(tmp_path: Path, uri: str) -> None:
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    _, before, _ = runs_in(uri)
    rows = [*ROWS[:-1], ("suv", "baseline", None, [0.1], True)]
    assert mirror(record(tmp_path / "out", rows), uri, "shift3d") is None
    client, after, groups = runs_in(uri)
    assert after.info.run_id != before.info.run_id and len(groups) == 5
    assert after.data.metrics["auc/shape/suv/baseline"] == 0.1
    assert len(curve_of(client, after, "recall/shape/baseline")) == 101


def test_beyond_the_limit_it_is_said_how_many_groups_are_shown(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_groups, "MOST_GROUPS", 2)
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    _, run, groups = runs_in(uri)
    assert run.data.tags["shift3d.groups_shown"] == "2 of 5"
    assert all(group.data.params["selected"] == "True" for group in groups.values()) and len(groups) == 2


def test_an_mlflow_that_is_away_is_a_reason_and_soon(tmp_path: Path) -> None:
    began = time.monotonic()
    problem = mirror(record(tmp_path / "out"), "http://127.0.0.1:9", "shift3d")
    assert problem and "\n" not in problem
    assert time.monotonic() - began < 30
    assert mirror(record(tmp_path / "out"), f"sqlite:///{tmp_path}/out/spec.yaml/mlflow.db", "shift3d")


def test_mean_aucs_are_columns_of_a_view_that_later_sweeps_widen(tmp_path: Path, uri: str) -> None:
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    client, run, _ = runs_in(uri)
    ((name, path),) = shared_views(client)
    assert name == "shift3d" and path == f"#/experiments/{run.info.experiment_id}/runs?viewStateShareKey=auc"
    shape = ["metrics.`shape/baseline`", "metrics.`shape/adversarial`"]
    assert sorted(columns(client)) == sorted([*shape, "metrics.`auc`"])
    share_view(client, run.info.experiment_id, ["pose/adversarial", "auc/pose/suv/adversarial"])
    assert columns(client)[0] == "metrics.`pose/adversarial`" and set(shape) < set(columns(client))
    assert len(columns(client)) == 4


def columns(client: Any) -> list[str]:
    tags = client.get_experiment_by_name("shift3d").tags
    found: list[str] = json.loads(tags["mlflow.sharedViewState.auc"])["selectedColumns"]
    return found
