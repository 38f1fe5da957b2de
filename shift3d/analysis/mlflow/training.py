"""MLflow run of a training: its recipe as params, its curves as metrics by step."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from shift3d.analysis.mlflow.client import attempt, experiment_of, flat, log, open_client, run_of
from shift3d.progress_bar import write_line


class TrainingCurves:
    """Writer of training curves to MLflow; call it with points at every checkpoint.

    The training saves its checkpoint first, so that a resumed training continues where the curve ends and writes no
    step twice. Points that could not be written are kept and retried with the next points. An unreachable MLflow costs
    a few seconds per checkpoint and never fails the training; a warning reports it, and another one at the end reports
    missing curves.

    Args:
        uri, experiment: of the store.
        name: name of the run, e.g. "train-sst". key: identifies the run when the training is resumed.
        params: the recipe, nested plain values.
    """

    def __init__(self, uri: str, experiment: str, name: str, key: str, params: Mapping[str, Any]) -> None:
        self.uri, self.experiment, self.name, self.key = uri, experiment, name, key
        self.problem: str | None = None
        self._warned = False
        self._params = flat(params)
        self._pending: list[tuple[int, Mapping[str, float]]] = []
        self._run_id: str | None = None

    def __call__(self, points: Sequence[tuple[int, Mapping[str, float]]]) -> None:
        """Write points: (step, values by name). Sets `problem` to the reason of a failure, else to None."""
        self._pending += points
        self.problem = attempt(self._write)
        if self.problem and not self._warned:
            self._warned = True
            write_line(f"warning: no curves in MLflow ({self.uri}): {self.problem}")

    def finish(self) -> None:
        """Write the pending points and mark the run as finished."""
        self(())
        run_id = self._run_id
        if self.problem is None and run_id is not None:
            self.problem = attempt(lambda: open_client(self.uri).set_terminated(run_id, "FINISHED"))
        if self.problem:
            write_line(f"warning: MLflow lacks some of the curves ({self.uri}): {self.problem}")

    def _write(self) -> None:
        client = open_client(self.uri)
        if self._run_id is None:
            experiment_id = experiment_of(client, self.experiment)
            run = run_of(client, experiment_id, self.name, "shift3d.training", self.key)
            client.update_run(run.info.run_id, status="RUNNING")
            self._run_id = str(run.info.run_id)
        points = [(name, value, step) for step, values in self._pending for name, value in values.items()]
        log(client, self._run_id, points, round(1000 * time.time()), self._params)
        self._pending = []
