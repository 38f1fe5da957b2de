"""MLflow run of a sweep: settings, AUCs, recall curves and final Parquet files, with one child run per group."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from shift3d.analysis.mlflow.client import (
    attempt,
    experiment_of,
    flat,
    log,
    metric_name,
    open_client,
    rounded,
    runs_of,
    share_view,
)
from shift3d.analysis.mlflow.sweep_groups import MOST_GROUPS, Recall, budget_points, groups, overall_metrics
from shift3d.analysis.tables.patterns import pattern_groups
from shift3d.analysis.tables.retrieval import retrieval_groups
from shift3d.store.resolve import LocationLike, local_copy

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run


def follow_up_metrics(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """Return metrics of the tables that `shift3d patterns` and `shift3d retrieve` add to ``final/``, if present.

    ``patterns/<group>/<measure>`` is a mean change over solutions. ``retrieval/<group>/retrieved``, ``baseline``,
    ``shape`` and ``controls`` are mean scores. ``retrieved`` is as `retrieval_groups` takes it.
    """
    found: dict[str, float] = {}
    if "patterns" in tables:
        for label, patterns in pattern_groups(tables["patterns"], tables["scores"]):
            found |= {f"patterns/{label}/{part.name} {part.unit}".strip(): part.change.mean for part in patterns}
    if "retrieved" in tables:
        for group in retrieval_groups(tables["retrieved"]):
            title = f"retrieval/{group.label}/{group.scored_by}"
            found |= {f"{title}/{name}": mean for name, mean in group.means.items() if mean == mean}
    return {metric_name(name): value for name, value in found.items()}


_FILES = ("spec.yaml", "env.json", "plan.parquet")


@dataclass(frozen=True)
class SweepRecord:
    """Data of a sweep for its MLflow run.

    sweep, spec_hash: run name, and the key under which a sweep finished again updates its run. folder: output folder;
    files of ``final/`` become artifacts. settings: nested plain values, logged flat as params. auc, curves:
    ``final/auc.parquet`` and ``final/curves.parquet`` as frames. counts: further metrics by name (tasks, seconds).
    """

    sweep: str
    spec_hash: str
    folder: LocationLike
    settings: Mapping[str, Any]
    auc: pd.DataFrame
    curves: pd.DataFrame
    counts: Mapping[str, float]


def mirror(record: SweepRecord, uri: str, experiment: str) -> str | None:
    """Write or update a sweep's run. Returns None, or the reason why MLflow could not be written.

    The results are in the sweep's folder: an error here is a warning and never fails the sweep.
    """
    return attempt(lambda: _write(record, uri, experiment))


def _write(record: SweepRecord, uri: str, experiment: str) -> None:
    client = open_client(uri)
    experiment_id = experiment_of(client, experiment)
    with local_copy(record.folder, ("final", *_FILES)) as folder:
        digest = hashlib.blake2b((folder / "final" / "scores.parquet").read_bytes(), digest_size=16).hexdigest()
        run_id = _run_of(client, experiment_id, record, digest)
        children = _write_children(client, experiment_id, run_id, record)
        aucs = _write_parent(client, run_id, record, children)
        share_view(client, experiment_id, aucs)
        _write_dataset(client, run_id, record, digest)
        client.log_artifacts(run_id, str(folder / "final"), "final")
        for name in _FILES:
            client.log_artifact(run_id, str(folder / name))
    client.log_text(run_id, record.auc.to_csv(index=False), "auc.csv")
    client.set_terminated(run_id, "FINISHED")


def _run_of(client: MlflowClient, experiment_id: str, record: SweepRecord, digest: str) -> str:
    """Return the sweep's run by the hash of its spec, or create a run.

    If the scores of the spec have changed (quarantined tasks have run since), a new run replaces the old one, because
    MLflow cannot delete points of a logged curve.
    """
    for run in runs_of(client, experiment_id, "shift3d.spec_hash", record.spec_hash):
        if run.data.tags.get("shift3d.scores", digest) == digest:
            return str(run.info.run_id)
        for child in (*_children(client, experiment_id, run.info.run_id).values(), run):
            client.delete_run(child.info.run_id)
    tags = {"shift3d.spec_hash": record.spec_hash, "shift3d.sweep": record.sweep, "shift3d.scores": digest}
    name = f"{record.sweep}-{record.spec_hash}"
    return str(client.create_run(experiment_id, run_name=name, tags=tags).info.run_id)


def _children(client: MlflowClient, experiment_id: str, run_id: str) -> dict[str, Run]:
    runs = runs_of(client, experiment_id, "mlflow.parentRunId", run_id, most=5 * MOST_GROUPS)
    return {run.data.tags.get("shift3d.group", ""): run for run in runs}


def _write_children(client: MlflowClient, experiment_id: str, run_id: str, record: SweepRecord) -> str:
    """Write the runs of groups that are missing or incomplete. Returns "N of M": groups with a run, and all groups."""
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
        points = [*((name, value, 0) for name, value in group.metrics.items()), *_points(recalls)]
        # Always the same timestamp: a retry after an interrupted write repeats points and adds none.
        log(client, child.info.run_id, points, child.info.start_time, group.params)
        client.set_terminated(child.info.run_id, "FINISHED")
    return f"{len(shown)} of {len(record.auc)}"


def _points(recalls: Mapping[str, Recall]) -> list[tuple[str, float, int]]:
    """Convert curves to metric points over the threshold in percent."""
    return [(name, value, percent) for name, recall in recalls.items() for percent, value in enumerate(recall)]


def _write_parent(client: MlflowClient, run_id: str, record: SweepRecord, children: str) -> list[str]:
    """Write AUCs, curves, counts and settings. Returns the names of the AUCs."""
    run = client.get_run(run_id)
    aucs, recalls = overall_metrics(record.auc, record.curves)
    known = run.data.metrics
    values = {**aucs, **record.counts}
    changed = [(name, value, 0) for name, value in values.items() if known.get(name) != rounded(value)]
    for name, text in (("shift3d.folder", str(record.folder)), ("shift3d.groups_shown", children)):
        client.set_tag(run_id, name, text)
    # MLflow shows the value with the latest timestamp, so a changed count needs a new timestamp.
    log(client, run_id, changed, int(1e3 * time.time()), {"sweep": record.sweep, **flat(record.settings)})
    log(client, run_id, [*_points(recalls), *budget_points(record.auc)], run.info.start_time)
    return list(aucs)


def _write_dataset(client: MlflowClient, run_id: str, record: SweepRecord, digest: str) -> None:
    """Log the scores as a dataset by the hash of their content; sweeps with equal digests have equal scores."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    source = json.dumps({"uri": f"{record.folder}/final/scores.parquet"})
    rows = json.dumps({"groups": len(record.auc), "scores": int(record.auc["scores"].sum())})
    dataset = Dataset(f"{record.sweep}-scores", digest, "local", source, profile=rows)
    client.log_inputs(run_id, [DatasetInput(dataset, [InputTag("mlflow.data.context", "scores")])])
