"""A gate in a real sqlite MLflow: once per gate, however often it is mirrored; MLflow never fails the gate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from suites_by_hand import write_detector, write_suite

from shift3d.analysis.mlflow.measurement_runs import GATE_EXPERIMENT, mirror_gate
from shift3d.cli.main import main


def test_a_gate_is_one_run_with_its_measures(tmp_path: Path, uri: str) -> None:
    write_suite(tmp_path / "suite", scored_by="own")
    module, weights = write_detector(tmp_path, -3.0)
    words = ["suite=suite", "detector=own", f"module={module}", f"weights={weights}", "out=out"]
    for _ in range(2):
        assert main(["gate", *words, f"mlflow={uri}"]) == 6
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name(GATE_EXPERIMENT)
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_bytes())
    assert run.data.metrics["worse"] == 1.0
    assert run.data.metrics["hard/recall/change"] == pytest.approx(verdict["measures"][0]["change"])
    assert run.data.metrics["hard/lost"] == verdict["objects"]["hard"]["lost"] > 0
    assert run.data.params["suite"] == verdict["facts"]["suite"]
    assert {file.path for file in client.list_artifacts(run.info.run_id)} == {
        "gate.html",
        "gate.parquet",
        "verdict.json",
    }
    (tmp_path / "store").touch()  # a file in place of a folder
    assert "\n" not in (mirror_gate(tmp_path / "out", f"sqlite:///{tmp_path}/store/mlflow.db") or "\n")
