"""One MLflow run a sweep: settings, AUCs, recall curves and final Parquet files, and a run below it for each group."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from shift3d.store.resolve import LocationLike, local_copy
from shift3d.tracking.auc_view import share_view
from shift3d.tracking.sweep_groups import MOST_GROUPS, Recall, groups, metric_name, overall

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SweepRecord", "mirror", "patience"]

# An MLflow that is away must not hold a finished sweep up for MLflow's own default of minutes.
_PATIENCE = {
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_ENABLE_TELEMETRY": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
}

_FILES = ("spec.yaml", "env.json", "plan.parquet")
_MOST_METRICS, _MOST_PARAMS = 1000, 100  # MLflow's own limits of one batch


class SweepRecord:
    """What is mirrored of a sweep.

    Args:
        sweep, spec_hash: the run's name and what makes it the same run when a sweep is finished again.
        folder: the output folder; files of ``final/`` become artifacts.
        settings: nested plain values, logged flat as params.
        auc, curves: ``final/auc.parquet`` and ``final/curves.parquet`` as frames.
        counts: further metrics by name (tasks, seconds).
    """

    def __init__(
        self,
        sweep: str,
        spec_hash: str,
        folder: LocationLike,
        settings: Mapping[str, Any],
        auc: pd.DataFrame,
        curves: pd.DataFrame,
        counts: Mapping[str, float],
    ) -> None:
        self.sweep = sweep
        self.spec_hash = spec_hash
        self.folder = folder
        self.settings = settings
        self.auc = auc
        self.curves = curves
        self.counts = counts


def mirror(record: SweepRecord, uri: str, experiment: str) -> str | None:
    """Write a sweep's run, or write it again in place. Returns None, or why MLflow could not be written.

    A sweep's results are in its folder: whatever goes wrong here is a warning and never the sweep's failure.
    """
    with patience():
        try:
            _write(record, uri, experiment)
        except Exception as error:
            return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def _write(record: SweepRecord, uri: str, experiment: str) -> None:
    import mlflow
    from mlflow import MlflowClient

    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    mlflow.set_tracking_uri(uri)
    client = MlflowClient(uri)
    found = client.get_experiment_by_name(experiment)
    experiment_id = found.experiment_id if found else client.create_experiment(experiment)
    with local_copy(record.folder, ("final", *_FILES)) as folder:
        digest = hashlib.blake2b((folder / "final" / "scores.parquet").read_bytes(), digest_size=16).hexdigest()
        run_id = _run_of(client, experiment_id, record, digest)
        children = _write_children(client, experiment_id, run_id, record)
        _write_parent(client, run_id, record, children)
        share_view(client, experiment_id, overall(record.auc, record.curves)[0])
        _write_dataset(client, run_id, record, digest)
        client.log_artifacts(run_id, str(folder / "final"), "final")
        for name in _FILES:
            client.log_artifact(run_id, str(folder / name))
    client.log_text(run_id, record.auc.to_csv(index=False), "auc.csv")
    client.set_terminated(run_id, "FINISHED")


def _run_of(client: Any, experiment_id: str, record: SweepRecord, digest: str) -> str:
    """The sweep's run, by the hash of its spec, or a new one.

    Other scores of the same spec (tasks that were given up on have run since) are another run, and replace it: in
    MLflow a curve that was logged cannot be taken back.
    """
    for run in client.search_runs([experiment_id], f"tags.`shift3d.spec_hash` = '{record.spec_hash}'"):
        if run.data.tags.get("shift3d.scores", digest) == digest:
            return str(run.info.run_id)
        for child in _children(client, experiment_id, run.info.run_id).values():
            client.delete_run(child.info.run_id)
        client.delete_run(run.info.run_id)
    tags = {"shift3d.spec_hash": record.spec_hash, "shift3d.sweep": record.sweep, "shift3d.scores": digest}
    name = f"{record.sweep}-{record.spec_hash}"
    return str(client.create_run(experiment_id, run_name=name, tags=tags).info.run_id)


def _children(client: Any, experiment_id: str, run_id: str) -> dict[str, Any]:
    """Runs of a sweep's groups by name."""
    which = f"tags.`mlflow.parentRunId` = '{run_id}'"
    runs = client.search_runs([experiment_id], which, max_results=5 * MOST_GROUPS)
    return {run.data.tags.get("shift3d.group", ""): run for run in runs}


def _write_children(client: Any, experiment_id: str, run_id: str, record: SweepRecord) -> str:
    """One run a group, those that are not there yet or were cut short. Returns how many of the groups have one."""
    there = _children(client, experiment_id, run_id)
    shown = groups(record.auc, record.curves)
    for group in shown:
        child = there.get(group.name)
        if child is None:
            tags = {"mlflow.parentRunId": run_id, "shift3d.group": group.name, "shift3d.sweep": record.sweep}
            child = client.create_run(experiment_id, run_name=group.name, tags=tags)
        elif child.info.status == "FINISHED":
            continue
        recalls = {} if group.recall is None else {"recall": group.recall}
        # The same time again: a second try after one that was cut short repeats points and adds none.
        _log(client, child.info.run_id, child.info.start_time, group.metrics, recalls, dict(group.params))
        client.set_terminated(child.info.run_id, "FINISHED")
    return f"{len(shown)} of {len(record.auc)}"


def _write_parent(client: Any, run_id: str, record: SweepRecord, children: str) -> None:
    run = client.get_run(run_id)
    values, recalls = overall(record.auc, record.curves)
    values |= {name: float(value) for name, value in record.counts.items()}
    known = run.data.metrics
    changed = {name: value for name, value in values.items() if known.get(name) != value}
    params = {name: value for name, value in _params(record).items() if name not in run.data.params}
    for name, text in (("shift3d.folder", str(record.folder)), ("shift3d.groups_shown", children)):
        client.set_tag(run_id, name, text)
    # What is logged later is the value that MLflow shows, so a count that has changed needs a time of its own.
    _log(client, run_id, int(1e3 * time.time()), changed, {}, params)
    _log(client, run_id, run.info.start_time, {}, recalls, {})


def _log(
    client: Any,
    run_id: str,
    at_ms: int,
    metrics: Mapping[str, float],
    recalls: Mapping[str, Recall],
    params: Mapping[str, str],
) -> None:
    """Metrics, curves over the threshold in percent, and params, in batches that MLflow takes."""
    from mlflow.entities import Metric, Param

    points = [Metric(metric_name(name), value, at_ms, 0) for name, value in metrics.items()]
    for name, recall in recalls.items():
        points += [Metric(name, float(value), at_ms, percent) for percent, value in enumerate(recall)]
    for start in range(0, len(points), _MOST_METRICS):
        client.log_batch(run_id, metrics=points[start : start + _MOST_METRICS])
    texts = [Param(name, value) for name, value in params.items()]
    for start in range(0, len(texts), _MOST_PARAMS):
        client.log_batch(run_id, params=texts[start : start + _MOST_PARAMS])


def _write_dataset(client: Any, run_id: str, record: SweepRecord, digest: str) -> None:
    """What the numbers were taken over, by the hash of its content: two sweeps with one digest have the same scores."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    source = json.dumps({"uri": f"{record.folder}/final/scores.parquet"})
    rows = json.dumps({"groups": len(record.auc), "scores": int(record.auc["scores"].sum())})
    dataset = Dataset(f"{record.sweep}-scores", digest, "local", source, profile=rows)
    client.log_inputs(run_id, [DatasetInput(dataset, [InputTag("mlflow.data.context", "scores")])])


def _params(record: SweepRecord) -> dict[str, str]:
    flat: dict[str, str] = {"sweep": record.sweep}

    def walk(values: Mapping[str, Any], prefix: str) -> None:
        for key, value in values.items():
            if isinstance(value, Mapping):
                walk(value, f"{prefix}{key}.")
            elif value is not None:
                flat[f"{prefix}{key}"] = str(value)[:500]

    walk(record.settings, "")
    return flat


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """MLflow gives up after seconds, not minutes, while this is open."""
    added = {name: value for name, value in _PATIENCE.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
