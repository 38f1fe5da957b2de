"""A real sqlite MLflow: one run per measured table, every setting distinct, and MLflow never fails the frontier."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from frontier_by_hand import frontier_row, realistic_rows

from shift3d.analysis.mlflow.measurement_runs import frontier_metrics, mirror_frontier
from shift3d.store.frontier_table import frontier_table
from shift3d.store.tables import write_table

FILES = ["advice.txt", "frontier.parquet", "frontier.png", "report.html"]


def folder_of(path: Path, rows: list[dict[str, Any]]) -> Path:
    write_table(path / "frontier.parquet", frontier_table(rows, {"cores": 2, "processor": "some"}))
    for name in ("frontier.png", "report.html", "advice.txt"):
        (path / name).write_bytes(b"content")
    return path


def runs_of(uri: str) -> list[Any]:
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("shift3d")
    return list(client.search_runs([experiment.experiment_id])) if experiment else []


def test_a_run_a_table_with_every_number_and_file(tmp_path: Path, uri: str) -> None:
    # More than a thousand numbers, MLflow's limit per call.
    rows = [*realistic_rows(), *realistic_rows("kitti")]
    folder = folder_of(tmp_path / "frontier", rows)
    assert mirror_frontier(folder, uri, "shift3d") is None
    assert mirror_frontier(folder, uri, "shift3d") is None
    (run,) = runs_of(uri)
    assert run.info.status == "FINISHED" and run.info.run_name.startswith("frontier-")
    assert run.data.metrics == pytest.approx(frontier_metrics(rows)) and len(run.data.metrics) > 1000
    assert run.data.metrics["street/standard_ warm/ms_median"] == 0.62
    assert run.data.params == {"machine.cores": "2", "machine.processor": "some"}
    from mlflow import MlflowClient

    assert sorted(file.path for file in MlflowClient(uri).list_artifacts(run.info.run_id)) == FILES


def test_another_measurement_is_another_run(tmp_path: Path, uri: str) -> None:
    for ms in (1.0, 2.0):
        assert mirror_frontier(folder_of(tmp_path / "f", [frontier_row("draft", ms)]), uri, "shift3d") is None
    runs = runs_of(uri)
    assert sorted(run.data.metrics["street/draft/ms_median"] for run in runs) == [1.0, 2.0]
    assert len({run.info.run_name for run in runs}) == 2


def test_names_that_mlflow_takes_and_that_stay_apart() -> None:
    from mlflow.utils.validation import _validate_metric

    settings = ["march (0.1 m)", "march [0.1 m]", "a/b", "..", "tolerance 1e-3 %", "x" * 400, "x" * 401, " ", "µ"]
    metrics = frontier_metrics([frontier_row(setting, 1.0 + i) for i, setting in enumerate(settings)])
    times = [value for name, value in metrics.items() if name.endswith("/ms_median")]
    assert times == [1.0 + i for i in range(len(settings))]
    for name, value in metrics.items():
        _validate_metric(name, value, 0, 0)


def test_what_was_not_measured_is_no_metric() -> None:
    metrics = frontier_metrics([frontier_row("draft", 1.0, auc_delta=None, score_delta=0.5, pareto=False)])
    assert "street/draft/auc_delta" not in metrics
    assert (metrics["street/draft/score_delta"], metrics["street/draft/pareto"]) == (0.5, 0.0)
    assert not [
        name for name in metrics if name.rpartition("/")[2] in ("setting", "method", "knob", "preset", "scenes")
    ]


def test_an_mlflow_that_is_away_or_a_folder_that_is_incomplete_is_a_reason(tmp_path: Path, uri: str) -> None:
    folder = folder_of(tmp_path / "f", [frontier_row("draft", 1.0)])
    began = time.monotonic()
    problem = mirror_frontier(folder, "http://127.0.0.1:9", "shift3d")
    assert problem and "\n" not in problem
    assert time.monotonic() - began < 30
    (folder / "report.html").unlink()
    problem = mirror_frontier(folder, uri, "shift3d")
    assert problem is not None and "report.html is missing" in problem and runs_of(uri) == []
    (folder / "report.html").touch()
    (folder / "frontier.parquet").write_bytes(b"torn")
    problem = mirror_frontier(folder, uri, "shift3d")
    assert problem is not None and "cannot be read as Parquet" in problem and runs_of(uri) == []
