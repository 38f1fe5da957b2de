"""Kin of one solution: the shape in its place is that of the pool's code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from short_tasks import make_spec

from shift3d.retrieval.pool import Pool
from shift3d.store.resolve import as_location
from shift3d.store.tables import table_from_rows, write_table
from shift3d.sweep.execution.worker import completed_rows
from shift3d.task.assets import Assets
from shift3d.task.exchange import TaskResult
from shift3d.task.follow_ups.retrieval import RetrievalAssets, retrieval_task
from shift3d.task.follow_ups.verify import VerifyAssets


@pytest.fixture(scope="module")
def finished(shape: TaskResult, assets: Assets, tmp_path_factory: pytest.TempPathFactory) -> VerifyAssets:
    """Final tables of one real shape task."""
    rows, folder = completed_rows(make_spec(), "one", shape), tmp_path_factory.mktemp("final")
    for name in ("scores", "solutions"):
        write_table(folder / f"{name}.parquet", table_from_rows(name, rows[name]))
    return VerifyAssets(assets, as_location(folder))


def pool_of(assets: Assets, **changes: Any) -> Pool:
    """Return a pool that holds the task's own vehicle."""
    suv = assets.vehicles.vehicle("suv")
    row = {"status": "fitted", "flags": [], "dataset": "d", "scene": "s", "label": 0, "kind": "Car", "score": 0.5}
    row |= {"latent_code": suv.latent_code.tolist(), "scale_m": suv.scale_m, "range_m": 20.0, "points": 100}
    return Pool.of({name: [value] for name, value in (row | changes).items()}, "pool")


def test_the_unchanged_vehicle_in_the_place_of_a_shape_scores_as_the_baseline_whose_coordinates_it_may_have(
    finished: VerifyAssets,
) -> None:
    """Coordinates belong to the vehicles that a pool was fitted with; a sweep may have others of its decoder."""
    found = [
        retrieval_task(make_spec(), RetrievalAssets(finished, pool_of(finished.assets, coordinates=u))).retrieved
        for u in (np.zeros(10).tolist(), [4.0, *[0.0] * 9])
    ]
    assert found[0] == found[1]
    (row,) = found[0]
    assert row["role"] == "retrieved" and row["latent_distance"] > 0.0 and not row["excluded"]
    assert row["score"] == pytest.approx(row["score_baseline"], abs=0.02)
