"""Curves of a training in a real sqlite MLflow: every step once; MLflow never fails the training."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.analysis.mlflow.training import TrainingCurves


def test_curves_of_an_interrupted_training_are_one_run(uri: str) -> None:
    params = {"recipe": {"steps": 4, "network": {"width": 8}}, "start": None}
    first = TrainingCurves(uri, "training", "train-sst", "out sst", params)
    first([(1, {"class": 2.0, "learning_rate": 0.1}), (2, {"class": 1.5, "learning_rate": 0.2})])
    resumed = TrainingCurves(uri, "training", "train-sst", "out sst", params)
    resumed([(3, {"class": 1.0, "learning_rate": 0.1})])
    resumed([(4, {"class": 0.5, "learning_rate": 0.0})])
    resumed.finish()
    assert first.problem is None and resumed.problem is None
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("training")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED" and run.info.run_name == "train-sst"
    assert run.data.params == {"recipe.steps": "4", "recipe.network.width": "8"}
    for name, values in (("class", [2.0, 1.5, 1.0, 0.5]), ("learning_rate", [0.1, 0.2, 0.1, 0.0])):
        history = sorted(client.get_metric_history(run.info.run_id, name), key=lambda metric: metric.step)
        assert [(metric.step, metric.value) for metric in history] == list(enumerate(values, start=1))


def test_points_wait_for_an_mlflow_that_is_away(tmp_path: Path, uri: str) -> None:
    (tmp_path / "store").touch()  # a file in place of a folder
    curves = TrainingCurves(f"sqlite:///{tmp_path}/store/mlflow.db", "training", "train", "key", {})
    curves([(1, {"loss": 1.0})])
    assert curves.problem and "\n" not in curves.problem
    curves.uri = uri
    curves([(2, {"loss": 0.5})])
    assert curves.problem is None
    from mlflow import MlflowClient

    client = MlflowClient(curves.uri)
    (run,) = client.search_runs([experiment.experiment_id for experiment in client.search_experiments()])
    history = client.get_metric_history(run.info.run_id, "loss")
    assert sorted((metric.step, metric.value) for metric in history) == [(1, 1.0), (2, 0.5)]


def test_a_recipe_that_could_not_be_written_is_written_with_the_next_points(
    uri: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mlflow import MlflowClient

    def gone(*_: object, **__: object) -> None:
        raise ConnectionError("gone")

    curves = TrainingCurves(uri, "training", "train", "key", {"steps": 4})
    with monkeypatch.context() as away:
        away.setattr(MlflowClient, "log_batch", gone)  # the run exists, and then MLflow is gone
        curves([])
    assert curves.problem and "gone" in curves.problem
    curves([(1, {"loss": 1.0})])
    client = MlflowClient(uri)
    (run,) = client.search_runs([experiment.experiment_id for experiment in client.search_experiments()])
    assert run.data.params == {"steps": "4"} and run.data.metrics == {"loss": 1.0}
