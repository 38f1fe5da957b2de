"""A real sqlite MLflow: one run a sweep, written again in place, and never the sweep's failure."""

from __future__ import annotations

import time
from pathlib import Path

import pandas as pd
import pytest

from shift3d.tracking.mlflow import SweepRecord, mirror, serve_command


def record(folder: Path, adversarial: float = 0.4) -> SweepRecord:
    (folder / "final").mkdir(parents=True, exist_ok=True)
    (folder / "final" / "scores.parquet").write_bytes(b"rows")
    for name in ("spec.yaml", "env.json", "plan.parquet"):
        (folder / name).touch()
    rows = [
        ("coupe", "baseline", 0.8, True),
        ("coupe", "adversarial", adversarial, True),
        ("coupe", "adversarial", 0.9, False),
        ("suv", "adversarial", 0.2, True),
        ("suv", "baseline", None, True),
    ]
    auc = pd.DataFrame(rows, columns=["vehicle", "method", "auc", "selected"]).assign(
        mode="shape", alpha=0.01, detector="p", scored_by="p", accuracy="standard", effects="auto", scores=4
    )
    settings = {"attack": {"steps": 40}, "axes": {"vehicle": ["coupe", "suv"]}}
    return SweepRecord("default", "0123", folder, settings, auc, {"tasks_done": 60})


def test_one_run_with_aucs_settings_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MLflow puts artifacts of a sqlite store into ./mlruns
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    assert mirror(record(tmp_path / "out"), uri, "shift3d") is None
    assert mirror(record(tmp_path / "out", adversarial=0.5), uri, "shift3d") is None
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("shift3d")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED" and run.info.run_name == "default-0123"
    assert run.data.metrics == pytest.approx(
        {
            "auc/shape/coupe/baseline": 0.8,
            "auc/shape/coupe/adversarial": 0.5,
            "auc/shape/suv/adversarial": 0.2,
            "auc/shape/mean/baseline": 0.8,
            "auc/shape/mean/adversarial": 0.35,
            "tasks_done": 60.0,
        }
    )
    assert run.data.params["attack.steps"] == "40" and run.data.params["axes.vehicle"] == "['coupe', 'suv']"
    assert [file.path for file in client.list_artifacts(run.info.run_id, "final")] == ["final/scores.parquet"]


def test_an_mlflow_that_is_away_is_a_reason_and_soon(tmp_path: Path) -> None:
    began = time.monotonic()
    problem = mirror(record(tmp_path / "out"), "http://127.0.0.1:9", "shift3d")
    assert problem and "\n" not in problem
    assert time.monotonic() - began < 30
    assert mirror(record(tmp_path / "out"), f"sqlite:///{tmp_path}/out/spec.yaml/mlflow.db", "shift3d")


def test_the_server_is_on_loopback() -> None:
    arguments = serve_command("sqlite:///mlflow.db", 5000)
    assert arguments[arguments.index("--host") + 1] == "127.0.0.1"
