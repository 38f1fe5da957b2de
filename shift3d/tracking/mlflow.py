"""One MLflow run a sweep: its settings, its AUCs, and its final Parquet files."""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from shift3d.store.location import Place, local_copy

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SweepRecord", "mirror", "patience", "serve_command"]

# An MLflow that is away must not hold a finished sweep up for MLflow's own default of minutes.
_PATIENCE = {
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_ENABLE_TELEMETRY": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
}

_FILES = ("spec.yaml", "env.json", "plan.parquet")


class SweepRecord:
    """What is mirrored of a sweep.

    Args:
        sweep, spec_hash: the run's name and what makes it the same run when a sweep is finished again.
        folder: the output folder; files of ``final/`` become artifacts.
        settings: nested plain values, logged flat as params.
        auc: ``final/auc.parquet`` as a frame.
        counts: further metrics by name (tasks, seconds).
    """

    def __init__(
        self,
        sweep: str,
        spec_hash: str,
        folder: Place,
        settings: Mapping[str, Any],
        auc: pd.DataFrame,
        counts: Mapping[str, float],
    ) -> None:
        self.sweep = sweep
        self.spec_hash = spec_hash
        self.folder = folder
        self.settings = settings
        self.auc = auc
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
    from mlflow.entities import Metric, Param, RunTag

    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    mlflow.set_tracking_uri(uri)
    client = MlflowClient(uri)
    found = client.get_experiment_by_name(experiment)
    experiment_id = found.experiment_id if found else client.create_experiment(experiment)
    run_id = _run_of(client, experiment_id, record)
    now = client.get_run(run_id).info.start_time
    metrics = [Metric(name, value, now, 0) for name, value in _metrics(record).items()]
    params = [Param(name, value) for name, value in _params(record).items()]
    known = client.get_run(run_id).data.params
    client.log_batch(
        run_id,
        metrics=metrics,
        params=[param for param in params if param.key not in known],
        tags=[RunTag("shift3d.folder", str(record.folder))],
    )
    with local_copy(record.folder, ("final", *_FILES)) as folder:
        client.log_artifacts(run_id, str(folder / "final"), "final")
        for name in _FILES:
            client.log_artifact(run_id, str(folder / name))
    client.set_terminated(run_id, "FINISHED")


def _run_of(client: Any, experiment_id: str, record: SweepRecord) -> str:
    """The sweep's run, by the hash of its spec, or a new one."""
    runs = client.search_runs([experiment_id], f"tags.`shift3d.spec_hash` = '{record.spec_hash}'", max_results=1)
    if runs:
        return str(runs[0].info.run_id)
    tags = {"shift3d.spec_hash": record.spec_hash, "shift3d.sweep": record.sweep}
    name = f"{record.sweep}-{record.spec_hash}"
    return str(client.create_run(experiment_id, run_name=name, tags=tags).info.run_id)


def _metrics(record: SweepRecord) -> dict[str, float]:
    """``auc/shape/coupe/adversarial`` and ``auc/shape/mean/adversarial``, of the chosen lambda."""
    metrics = {name: float(value) for name, value in record.counts.items()}
    rows = record.auc[record.auc["selected"] & record.auc["auc"].notna()]
    if rows.empty:
        return metrics
    variants = ["alpha", "detector", "scored_by", "accuracy", "effects"]
    several = [name for name in variants if rows[name].nunique() > 1]
    by_mean: dict[str, list[float]] = {}
    for key, group in rows.groupby(["mode", "vehicle", "method", *several], sort=False):
        mode, vehicle, method, *variant = (str(part) for part in key)
        tail = "/".join([method, *variant])
        auc = float((group["auc"] * group["scores"]).sum() / group["scores"].sum())
        metrics[_name(f"auc/{mode}/{vehicle}/{tail}")] = auc
        by_mean.setdefault(_name(f"auc/{mode}/mean/{tail}"), []).append(auc)
    return metrics | {name: sum(values) / len(values) for name, values in by_mean.items()}


def _name(text: str) -> str:
    return re.sub(r"[^\w\-. /]", "_", text)


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


def serve_command(uri: str, port: int, workers: int = 1) -> list[str]:
    """Arguments of ``mlflow ui`` on loopback."""
    return [
        "ui",
        "--backend-store-uri",
        uri,
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
        "--workers",
        str(workers),
    ]


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
