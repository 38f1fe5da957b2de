"""MLflow runs of a training (its recipe as params, its curves as metrics against the step) and of a gate."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.analysis.mlflow.client import attempt, experiment_of, flat, log, open_client, runs_of

if TYPE_CHECKING:
    from mlflow import MlflowClient

GATE_EXPERIMENT = "shift3d-gate"
_FILES = ("verdict.json", "gate.parquet", "gate.html")


def mirror_gate(folder: Path, uri: str) -> str | None:
    """Write the run of a gate's folder; the same suite, weights and release before are one run, written in place.

    Returns None, or why MLflow could not be written.
    """
    return attempt(lambda: _write(folder, uri))


def _write(folder: Path, uri: str) -> None:
    verdict = json.loads((folder / _FILES[0]).read_bytes())
    facts = verdict["facts"]
    key = " ".join(facts[name] for name in ("suite", "detector", "weights", "against", "rule"))
    client = open_client(uri)
    experiment = experiment_of(client, GATE_EXPERIMENT)
    found = runs_of(client, experiment, "shift3d.gate", key, most=1)
    name = f"gate-{facts['detector']}-{facts['weights'][:8]}"
    run = found[0] if found else client.create_run(experiment, run_name=name, tags={"shift3d.gate": key})
    metrics = {"worse": float(verdict["worse"])}
    for measure in verdict["measures"]:
        title = f"{measure['role']}/{measure['name']}"
        metrics |= {f"{title}/{what}": measure[what] for what in ("before", "after", "change", "p_value")}
    metrics |= {f"{role}/lost": counts["lost"] for role, counts in verdict["objects"].items()}
    points = [(metric, value, 0) for metric, value in metrics.items()]
    log(client, run.info.run_id, points, run.info.start_time, flat(facts))
    for file in _FILES:
        client.log_artifact(run.info.run_id, str(folder / file))
    client.set_terminated(run.info.run_id, "FINISHED")


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
        self._params = flat(params)
        self._pending: list[tuple[int, Mapping[str, float]]] = []
        self._run_id: str | None = None

    def __call__(self, points: Sequence[tuple[int, Mapping[str, float]]]) -> None:
        """Write points: (step, values by name). Sets `problem` to why they could not be written, else to None."""
        self._pending += points
        self.problem = attempt(self._write)

    def finish(self) -> None:
        """Write what is left and mark the run as finished."""
        self(())
        run_id = self._run_id
        if self.problem is None and run_id is not None:
            self.problem = attempt(lambda: open_client(self.uri).set_terminated(run_id, "FINISHED"))

    def _write(self) -> None:
        client = open_client(self.uri)
        if self._run_id is None:
            self._run_id = self._run(client)
            log(client, self._run_id, (), 0, self._params)
        points = [(name, value, step) for step, values in self._pending for name, value in values.items()]
        log(client, self._run_id, points, round(1000 * time.time()))
        self._pending = []

    def _run(self, client: MlflowClient) -> str:
        experiment_id = experiment_of(client, self.experiment)
        for run in runs_of(client, experiment_id, "shift3d.training", self.key, most=1):
            client.update_run(run.info.run_id, status="RUNNING")
            return str(run.info.run_id)
        tags = {"shift3d.training": self.key}
        return str(client.create_run(experiment_id, run_name=self.name, tags=tags).info.run_id)
