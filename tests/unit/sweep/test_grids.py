"""Grids of transfers, and the scenes that a plan chooses for them."""

from __future__ import annotations

import dataclasses
from typing import Any

import pandas as pd
import pytest
from by_hand import catalogue

from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.store.tables import table_from_rows
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.results.bev_grids import transfer_rows


def five_scenes(config: Config) -> Catalogue:
    scenes = tuple(SceneEntry(f"s{i}", "street", f"hash{i}", SceneFacts(f"s{i}")) for i in range(5))
    return dataclasses.replace(catalogue(config), scenes=scenes)


def transfer(x: float, y: float, before: float | None, after: float | None, **more: Any) -> dict[str, Any]:
    group = {"sweep": "s", "dataset": "street", "vehicle": "suv", "mode": "shape", "lambda": 1.0, "alpha": 0.01}
    group |= {"detector": "p", "accuracy": "standard", "search": "descent", "effects": "none", "scored_by": "p"}
    return {**group, "x_m": x, "y_m": y, "score_baseline": before, "score": after, **more}


def test_cells_hold_the_mean_reduction_and_empty_ones_are_rows_without_scores() -> None:
    rows = [transfer(12.0, -3.0, 0.9, 0.4), transfer(18.0, -8.0, 0.7, 0.6), transfer(-11.0, 4.0, 0.5, 0.5)]
    rows.append(transfer(3.0, 3.0, None, None))
    found = transfer_rows(pd.DataFrame(rows), 20.0)
    assert len(found) == 4 * 4
    filled = {(row["cell_x_m"], row["cell_y_m"]): row for row in found if row["scores"]}
    assert set(filled) == {(10.0, -10.0), (-20.0, 0.0)}
    assert filled[10.0, -10.0]["scores"] == 2 and filled[10.0, -10.0]["mean_reduction"] == pytest.approx(0.3)
    assert filled[-20.0, 0.0]["mean_reduction"] == 0.0
    assert all(row["mean_reduction"] is None for row in found if not row["scores"])
    assert table_from_rows("bev_transfer", found).num_rows == 16


def test_without_transfers_there_is_no_grid() -> None:
    wide = transfer_rows(pd.DataFrame([transfer(1.0, 1.0, 0.9, 0.4)]), 1e9)
    assert len(wide) == 100, "cells without a vehicle end where vehicles stand, at 50 m at least"
    assert transfer_rows(pd.DataFrame([transfer(1.0, 1.0, 0.9, 0.4)]).iloc[:0], 20.0) == []


def test_detectors_and_lambdas_have_grids_of_their_own() -> None:
    rows = [transfer(12.0, 3.0, 0.9, 0.4, scored_by=by, **{"lambda": weight}) for by in "pq" for weight in (1.0, 10.0)]
    found = [row for row in transfer_rows(pd.DataFrame(rows), 20.0) if row["scores"]]
    assert [(row["lambda"], row["scored_by"]) for row in found] == [(1.0, "p"), (10.0, "p"), (1.0, "q"), (10.0, "q")]


def test_a_task_is_transferred_into_the_next_scenes_of_the_set() -> None:
    words = ["vehicle=suv", "attack.lambda=1", "attack.transfer_scenes=2"]
    specs = [task.spec for task in make_plan(compose_sweep("default", words), five_scenes)[0].tasks]
    chosen = {spec.scene: [other.scene for other in spec.transfer_scenes] for spec in specs if spec.mode == "shape"}
    assert chosen == {
        "s0": ["s1", "s2"],
        "s1": ["s2", "s3"],
        "s2": ["s3", "s4"],
        "s3": ["s4", "s0"],
        "s4": ["s0", "s1"],
    }
    assert specs[0].transfer_scenes[0].scene_hash == "hash1"
    assert all(spec.transfer_scenes == () for spec in specs if spec.mode == "pose")
    # A universal shape is searched in the first scenes, and scored in as many others.
    wide = [
        task.spec
        for task in make_plan(compose_sweep("default", [*words, "attack.search_scenes=1"]), five_scenes)[0].tasks
    ]
    assert {len(spec.transfer_scenes) for spec in wide if spec.mode == "shape"} == {3}
    # A scene given by name is still transferred to others of the whole set.
    (one,) = (
        task.spec
        for task in make_plan(compose_sweep("default", [*words, "mode=shape", "scene=s4"]), five_scenes)[0].tasks
    )
    assert one.task_id == next(spec.task_id for spec in specs if (spec.scene, spec.mode) == ("s4", "shape"))


def test_more_scenes_than_there_are_is_refused() -> None:
    words = ["vehicle=suv", "mode=shape", "attack.transfer_scenes=5"]
    with pytest.raises(InputError, match=r"need 5 scenes, and the set has 4 others\. Give scenes\.count=6 or more"):
        make_plan(compose_sweep("default", words), five_scenes)
