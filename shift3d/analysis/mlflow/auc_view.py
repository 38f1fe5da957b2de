"""A view of MLflow's list of runs that has AUC columns.

MLflow 3.17 keeps the columns of a list in the browser, and starts with none for metrics. What it shares between users
is a view behind a link: an experiment's tag that holds the view as JSON, named in the link by its key.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mlflow import MlflowClient

_KEY = "auc"
_TAG = f"mlflow.sharedViewState.{_KEY}"
_MOST_COLUMNS = 24
_GROUP = "metrics.`auc`"  # of the runs below a sweep's, a group each


def share_view(client: MlflowClient, experiment_id: str, metrics: Iterable[str]) -> None:
    """Put mean AUCs, as columns, into the experiment's view, beside those of the sweeps before.

    metrics: names as `overall` gives them, of which those of means over vehicles are taken.
    """
    means = [f"metrics.`{name}`" for name in metrics if not name.startswith("auc/")]
    tag = client.get_experiment(experiment_id).tags.get(_TAG)
    before = json.loads(tag)["selectedColumns"] if tag else []
    columns = list(dict.fromkeys([*means, *before, _GROUP]))[:_MOST_COLUMNS]
    client.set_experiment_tag(experiment_id, _TAG, json.dumps({"selectedColumns": columns}))


def shared_views(client: MlflowClient) -> Iterator[tuple[str, str]]:
    """(name, path of its list of runs with AUC columns) of each experiment that has such a view."""
    for experiment in client.search_experiments():
        if _TAG in experiment.tags:
            yield experiment.name, f"#/experiments/{experiment.experiment_id}/runs?viewStateShareKey={_KEY}"
