"""MLflow client helpers: short timeouts, runs looked up by tag, batched logging, and a shared view with AUC columns."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

# An unreachable MLflow must not delay a finished sweep for MLflow's default of minutes.
_PATIENCE = {
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_ENABLE_TELEMETRY": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
}
_LONGEST_PARAM = 500
LONGEST_NAME = 250  # MLflow's own limit


@contextlib.contextmanager
def short_timeouts() -> Iterator[None]:
    """Make MLflow give up after seconds instead of minutes within this context."""
    added = {name: value for name, value in _PATIENCE.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def attempt(write: Callable[[], None]) -> str | None:
    """Call `write`. Returns None, or the reason why it failed: a command never fails because of its mirror."""
    with short_timeouts():
        try:
            write()
        except Exception as error:
            return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def open_client(uri: str) -> MlflowClient:
    """Open a client of a store, without MLflow's own messages."""
    import mlflow
    from mlflow import MlflowClient

    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    mlflow.set_tracking_uri(uri)
    return MlflowClient(uri)


def experiment_of(client: MlflowClient, name: str) -> str:
    """Return the id of an experiment; create the experiment if it does not exist."""
    found = client.get_experiment_by_name(name)
    return str(found.experiment_id if found else client.create_experiment(name))


def runs_of(client: MlflowClient, experiment_id: str, tag: str, value: str, most: int = 1000) -> list[Run]:
    """Return the runs that have a tag."""
    return list(client.search_runs([experiment_id], f"tags.`{tag}` = '{value}'", max_results=most))


def run_of(client: MlflowClient, experiment_id: str, name: str, tag: str, value: str, **tags: str) -> Run:
    """Return the run that has a tag, or create a run with that name, the tag and further tags."""
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
    """Log metrics as (name, value, step), and the params that the run does not have yet."""
    from mlflow.entities import Metric, Param

    metrics = [Metric(metric_name(name), rounded(value), at_ms, step) for name, value, step in points]
    known = client.get_run(run_id).data.params if params else {}
    texts = [Param(name, value) for name, value in (params or {}).items() if name not in known]
    client.log_batch(run_id, metrics, texts)


def rounded(value: float) -> float:
    """Round a metric to remove float noise: the mean of 0.2 and 0.4 is 0.3, not 0.30000000000000004."""
    return round(float(value), 12)


def metric_name(text: str) -> str:
    """Replace the characters that MLflow refuses in a name; a hash replaces the end of a name that is too long."""
    name = re.sub(r"[^\w\-. /]", "_", text)
    if len(name) <= LONGEST_NAME:
        return name
    digest = hashlib.blake2b(name.encode(), digest_size=8).hexdigest()
    return f"{name[: LONGEST_NAME - len(digest) - 1]}-{digest}"


def flat(params: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Flatten nested values to texts by dotted names; null values are left out."""
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
_GROUP_COLUMN = "metrics.`auc`"  # metric of a sweep's child runs, one run per group


def share_view(client: MlflowClient, experiment_id: str, metrics: Iterable[str]) -> None:
    """Add mean AUCs as columns to the experiment's shared view, beside those of earlier sweeps.

    MLflow 3.17 keeps the columns of a run list in the browser, and initially shows no metrics. Users can share a view
    only by a link: an experiment tag holds the view as JSON, and the link contains the tag's key.

    metrics: names as returned by `overall_metrics`; only means over vehicles become columns.
    """
    means = [f"metrics.`{name}`" for name in metrics if not name.startswith("auc/")]
    tag = client.get_experiment(experiment_id).tags.get(_VIEW_TAG)
    before = json.loads(tag)["selectedColumns"] if tag else []
    columns = list(dict.fromkeys([*means, *before, _GROUP_COLUMN]))[:_MOST_COLUMNS]
    client.set_experiment_tag(experiment_id, _VIEW_TAG, json.dumps({"selectedColumns": columns}))


def shared_views(client: MlflowClient) -> Iterator[tuple[str, str]]:
    """Yield (name, path of the run list with AUC columns) of each experiment with a shared view."""
    for experiment in client.search_experiments():
        if _VIEW_TAG in experiment.tags:
            yield experiment.name, f"#/experiments/{experiment.experiment_id}/runs?viewStateShareKey={_VIEW_KEY}"
