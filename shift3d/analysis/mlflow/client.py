"""What every mirror needs of MLflow: a client that gives up soon, runs found again, batches, a view with AUCs."""

from __future__ import annotations

import contextlib
import json
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
_LONGEST_PARAM = 500


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


def run_of(client: MlflowClient, experiment_id: str, name: str, tag: str, value: str, **tags: str) -> Run:
    """The run that has a tag; where there is none, a new one of that name, with the tag and more tags."""
    for run in runs_of(client, experiment_id, tag, value, most=1):
        return run
    return client.create_run(experiment_id, run_name=name, tags={tag: value, **tags})


def log(
    client: MlflowClient,
    run_id: str,
    points: Iterable[tuple[str, float, int]],
    at_ms: int,
    params: Mapping[str, str] | None = None,
) -> None:
    """Metrics as (name, value, step), and params that the run does not have yet."""
    from mlflow.entities import Metric, Param

    metrics = [Metric(metric_name(name), rounded(value), at_ms, step) for name, value, step in points]
    known = client.get_run(run_id).data.params if params else {}
    texts = [Param(name, value) for name, value in (params or {}).items() if name not in known]
    client.log_batch(run_id, metrics, texts)


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


_VIEW_KEY = "auc"
_VIEW_TAG = f"mlflow.sharedViewState.{_VIEW_KEY}"
_MOST_COLUMNS = 24
_GROUP_COLUMN = "metrics.`auc`"  # of the runs below a sweep's, a group each


def share_view(client: MlflowClient, experiment_id: str, metrics: Iterable[str]) -> None:
    """Put mean AUCs, as columns, into the experiment's view, beside those of the sweeps before.

    MLflow 3.17 keeps the columns of a list in the browser, and starts with none for metrics. What it shares between
    users is a view behind a link: an experiment's tag that holds the view as JSON, named in the link by its key.

    metrics: names as `overall` gives them, of which those of means over vehicles are taken.
    """
    means = [f"metrics.`{name}`" for name in metrics if not name.startswith("auc/")]
    tag = client.get_experiment(experiment_id).tags.get(_VIEW_TAG)
    before = json.loads(tag)["selectedColumns"] if tag else []
    columns = list(dict.fromkeys([*means, *before, _GROUP_COLUMN]))[:_MOST_COLUMNS]
    client.set_experiment_tag(experiment_id, _VIEW_TAG, json.dumps({"selectedColumns": columns}))


def shared_views(client: MlflowClient) -> Iterator[tuple[str, str]]:
    """(name, path of its list of runs with AUC columns) of each experiment that has such a view."""
    for experiment in client.search_experiments():
        if _VIEW_TAG in experiment.tags:
            yield experiment.name, f"#/experiments/{experiment.experiment_id}/runs?viewStateShareKey={_VIEW_KEY}"
