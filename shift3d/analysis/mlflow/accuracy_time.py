"""One MLflow run a measured frontier: every setting's numbers, and the files of its folder."""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.analysis.mlflow.sweep import patience
from shift3d.errors import InputError
from shift3d.store.frontier_table import FRONTIER_SCHEMA, machine_of, read_frontier

if TYPE_CHECKING:
    from mlflow import MlflowClient

__all__ = ["frontier_metrics", "mirror_frontier"]

_FILES = ("frontier.parquet", "frontier.png", "report.html", "advice.txt")
# What names a row is no metric of it.
_NAMES = ("setting", "method", "knob", "knob_name", "preset", "start", "grid", "gradient", "scenes")
_MOST_METRICS, _LONGEST_NAME = 1000, 250  # MLflow's own limits of one batch and of a metric's name


def mirror_frontier(folder: Path, uri: str, experiment: str) -> str | None:
    """Write the run "frontier-<hash of frontier.parquet>", or write it again in place.

    The hash is that of the measured table: another measurement is another run, so that they can be compared, and the
    same folder mirrored twice is one.

    Args:
        folder: with frontier.parquet, frontier.png, report.html and advice.txt, which become artifacts.
        uri, experiment: of the store.

    Returns:
        None, or why MLflow could not be written. The frontier is in its folder: nothing that goes wrong here is its
        failure.
    """
    with patience():
        try:
            _write(folder, uri, experiment)
        except Exception as error:
            return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def _write(folder: Path, uri: str, experiment: str) -> None:
    from mlflow.entities import Metric, Param

    # Before anything is written: half a run would look like a whole one.
    missing = [name for name in _FILES if not (folder / name).is_file()]
    if missing:
        raise InputError(f"{missing[0]} is missing", str(folder), "Write the frontier's report first")
    table = read_frontier(folder / "frontier.parquet")
    key = hashlib.blake2b((folder / "frontier.parquet").read_bytes(), digest_size=8).hexdigest()
    client = _client(uri)
    run_id = _run_of(client, experiment, key, folder)
    run = client.get_run(run_id)
    values = frontier_metrics(table.to_pylist())
    metrics = [Metric(name, value, run.info.start_time, 0) for name, value in values.items()]
    for first in range(0, len(metrics), _MOST_METRICS):
        client.log_batch(run_id, metrics=metrics[first : first + _MOST_METRICS])
    params = {f"machine.{_clean(name)}": str(value)[:500] for name, value in machine_of(table).items()}
    client.log_batch(run_id, params=[Param(k, v) for k, v in params.items() if k not in run.data.params])
    for name in _FILES:
        client.log_artifact(run_id, str(folder / name))
    client.set_terminated(run_id, "FINISHED")


def frontier_metrics(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Every number of every row as ``<scenes>/<setting>/<column>``, in characters that MLflow takes.

    What is null is left out; `pareto` is 1 or 0. Of settings whose names differ only in characters that MLflow does
    not take, the later ones get a number.

    Args:
        rows: the frontier's, as plain values by column.
    """
    columns = [name for name in FRONTIER_SCHEMA.names if name not in _NAMES]
    metrics: dict[str, float] = {}
    taken: set[str] = set()
    for row in rows:
        # Room for the longest column's name and a number.
        name = plain = f"{_clean(row['scenes'])}/{_clean(row['setting'])}"[: _LONGEST_NAME - 40].rstrip("/ .")
        number = 2
        while name in taken:
            name, number = f"{plain} {number}", number + 1
        taken.add(name)
        metrics |= {f"{name}/{column}": float(row[column]) for column in columns if row[column] is not None}
    return metrics


def _clean(text: str) -> str:
    """Text as one part of a metric's path: no separators, nothing that a path would simplify away."""
    return re.sub(r"[^\w\-. ]", "_", text).strip(" .") or "_"


def _client(uri: str) -> MlflowClient:
    import mlflow
    from mlflow import MlflowClient

    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    mlflow.set_tracking_uri(uri)
    return MlflowClient(uri)


def _run_of(client: MlflowClient, experiment: str, key: str, folder: Path) -> str:
    """The frontier's run, by the hash of its table, or a new one."""
    found = client.get_experiment_by_name(experiment)
    experiment_id = found.experiment_id if found else client.create_experiment(experiment)
    runs = client.search_runs([experiment_id], f"tags.`shift3d.frontier` = '{key}'", max_results=1)
    if runs:
        return str(runs[0].info.run_id)
    tags = {"shift3d.frontier": key, "shift3d.folder": str(folder)}
    return str(client.create_run(experiment_id, run_name=f"frontier-{key}", tags=tags).info.run_id)
