"""One MLflow run a training: its recipe as params, its curves as metrics against the step."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from shift3d.analysis.mlflow.sweep import patience

if TYPE_CHECKING:
    from mlflow import MlflowClient

__all__ = ["TrainingCurves"]

_MOST_METRICS = 1000  # MLflow's own limit of one batch


class TrainingCurves:
    """Writes curves to MLflow while a training goes on; call it with points, at every checkpoint.

    A training's checkpoint comes first, so that a resumed training goes on where the curve ends and no step is
    written twice. What could not be written is kept and tried again with the next points: an MLflow that is away
    costs a few seconds a checkpoint and never the training.

    Args:
        uri, experiment: of the store.
        name: of the run, e.g. "train-sst". key: what makes it the same run when the training is resumed.
        params: the recipe, nested plain values.
    """

    def __init__(self, uri: str, experiment: str, name: str, key: str, params: Mapping[str, Any]) -> None:
        self.uri, self.experiment, self.name, self.key = uri, experiment, name, key
        self.problem: str | None = None
        self._params = _flat(params)
        self._pending: list[tuple[int, Mapping[str, float]]] = []
        self._run_id: str | None = None

    def __call__(self, points: Sequence[tuple[int, Mapping[str, float]]]) -> None:
        """Write points: (step, values by name). Sets `problem` to why they could not be written, else to None."""
        self._pending += points
        with patience():
            try:
                self._write()
                self.problem = None
            except Exception as error:
                self.problem = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"

    def finish(self) -> None:
        """Write what is left and mark the run as finished."""
        self(())
        if self.problem is None and self._run_id is not None:
            with patience():
                try:
                    self._client().set_terminated(self._run_id, "FINISHED")
                except Exception as error:
                    self.problem = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"

    def _client(self) -> MlflowClient:
        import mlflow
        from mlflow import MlflowClient

        logging.getLogger("alembic").setLevel(logging.WARNING)
        logging.getLogger("mlflow").setLevel(logging.ERROR)
        mlflow.set_tracking_uri(self.uri)
        return MlflowClient(self.uri)

    def _write(self) -> None:
        from mlflow.entities import Metric, Param

        client = self._client()
        if self._run_id is None:
            run_id = self._run(client)
            known = client.get_run(run_id).data.params
            client.log_batch(run_id, params=[Param(k, v) for k, v in self._params.items() if k not in known])
            self._run_id = run_id
        now = round(1000 * time.time())
        metrics = [
            Metric(re.sub(r"[^\w\-. /]", "_", name), float(value), now, step)
            for step, values in self._pending
            for name, value in values.items()
        ]
        for first in range(0, len(metrics), _MOST_METRICS):
            client.log_batch(self._run_id, metrics=metrics[first : first + _MOST_METRICS])
        self._pending = []

    def _run(self, client: MlflowClient) -> str:
        found = client.get_experiment_by_name(self.experiment)
        experiment_id = found.experiment_id if found else client.create_experiment(self.experiment)
        runs = client.search_runs([experiment_id], f"tags.`shift3d.training` = '{self.key}'", max_results=1)
        if runs:
            run_id = str(runs[0].info.run_id)
            client.update_run(run_id, status="RUNNING")
            return run_id
        return str(
            client.create_run(experiment_id, run_name=self.name, tags={"shift3d.training": self.key}).info.run_id
        )


def _flat(params: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in params.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        elif value is not None:
            flat[f"{prefix}{key}"] = str(value)[:500]
    return flat
