"""What every mirror needs of MLflow: a client that gives up soon, runs found again, and batches of the right size."""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

# An MLflow that is away must not hold a finished sweep up for MLflow's own default of minutes.
_PATIENCE = {
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_ENABLE_TELEMETRY": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
}
_MOST_METRICS, _MOST_PARAMS, _LONGEST_PARAM = 1000, 100, 500  # MLflow's own limits of one batch, and ours of a text


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


def attempt(write: Callable[[], None]) -> str | None:
    """Write something. Returns None, or why it could not be written: a mirror is never what a command fails for."""
    with patience():
        try:
            write()
        except Exception as error:
            return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def open_client(uri: str) -> MlflowClient:
    """A client of a store, without MLflow's own messages."""
    import mlflow
    from mlflow import MlflowClient

    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    mlflow.set_tracking_uri(uri)
    return MlflowClient(uri)


def experiment_of(client: MlflowClient, name: str) -> str:
    """The id of an experiment, made where there is none."""
    found = client.get_experiment_by_name(name)
    return str(found.experiment_id if found else client.create_experiment(name))


def runs_of(client: MlflowClient, experiment_id: str, tag: str, value: str, most: int = 1000) -> list[Run]:
    """The runs that have a tag."""
    return list(client.search_runs([experiment_id], f"tags.`{tag}` = '{value}'", max_results=most))


def log(
    client: MlflowClient,
    run_id: str,
    points: Iterable[tuple[str, float, int]],
    at_ms: int,
    params: Mapping[str, str] | None = None,
) -> None:
    """Metrics as (name, value, step), and params that the run does not have yet, in batches that MLflow takes."""
    from mlflow.entities import Metric, Param

    metrics = [Metric(metric_name(name), rounded(value), at_ms, step) for name, value, step in points]
    for start in range(0, len(metrics), _MOST_METRICS):
        client.log_batch(run_id, metrics=metrics[start : start + _MOST_METRICS])
    known = client.get_run(run_id).data.params if params else {}
    texts = [Param(name, value) for name, value in (params or {}).items() if name not in known]
    for start in range(0, len(texts), _MOST_PARAMS):
        client.log_batch(run_id, params=texts[start : start + _MOST_PARAMS])


def rounded(value: float) -> float:
    """A metric without float noise: the mean of 0.2 and 0.4 is 0.3, and not 0.30000000000000004."""
    return round(float(value), 12)


def metric_name(text: str) -> str:
    """A name that MLflow takes."""
    return re.sub(r"[^\w\-. /]", "_", text)


def flat(params: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested values as texts by dotted names; what is null is left out."""
    found: dict[str, str] = {}
    for key, value in params.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        elif value is not None:
            found[f"{prefix}{key}"] = str(value)[:_LONGEST_PARAM]
    return found
