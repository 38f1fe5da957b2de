"""Final tables: committed segments in plan order, and tables computed from them.

The bytes depend only on the plan and the results, not on which worker ran a task or when.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from shift3d.errors import InputError
from shift3d.evaluation.recall_curve import area_under, recall_curve
from shift3d.methods import METHODS_OF_MODE
from shift3d.store.log import committed_rows
from shift3d.store.log_entries import Commit
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import FOLLOW_UPS, GROUP_COLUMNS, SWEEP_TABLES
from shift3d.store.tables import read_table, table_from_rows, write_table
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.results.bev_grids import bev_rows, groups, transfer_rows
from shift3d.sweep.results.hyperparameters import RULE_KEYS, choice_rows, choose_lambdas

if TYPE_CHECKING:
    import pandas as pd

VERIFICATION = "verification"
"""Folder of a verification in its sweep's folder: itself a sweep's folder, with a log and final tables."""
_PLAN_GROUP = GROUP_COLUMNS[:11]  # set by the task and the scoring detector
_VERIFIED_KEY = ["task_id", "scored_by", "method", "replicate"]
_VERIFIED = ("score_reference", "stable")


@dataclass(frozen=True)
class FinalTables:
    """Tables of ``final/``, by name."""

    tables: dict[str, pa.Table]

    def frame(self, name: str) -> pd.DataFrame:
        """Return one table as a data frame."""
        frame: pd.DataFrame = self.tables[name].to_pandas()
        return frame


def write_final(folder: LocationLike, plan: Plan, entries: Sequence[Commit]) -> FinalTables:
    """Write every table of ``final/`` from the commit log, ``scores`` last: with it, all other tables are there.

    Raises: InputError: a segment is missing, torn or of another length than was committed; a score lacks its place; a
    verification is damaged or of another version; the disk is full.
    """
    folder = as_location(folder)
    tables = {name: segments_in_plan_order(folder, entries, name, plan) for name in SWEEP_TABLES}
    if (path := folder / VERIFICATION / "final" / "verification.parquet").is_file():
        tables["verification"] = read_table(path, "verification")
        tables["scores"] = with_verification(tables["scores"], tables["verification"])
    scores = tables["scores"].to_pandas()
    scored = scores[scores["score"].notna()]
    if scored[["x_m", "y_m"]].isna().to_numpy().any():
        remedy = "Restore the folder from a copy, or run the sweep in another one"
        raise InputError("scores without a place", where=str(folder / "data"), remedy=remedy)
    scored = _by_effects_requested(scored, plan)
    auc = _auc_rows(scored, plan)
    tables["curves"] = table_from_rows("curves", _curve_rows(scored))
    tables["auc"] = table_from_rows("auc", auc)
    tables["bev"] = table_from_rows("bev", bev_rows(scored))
    steps = {group.template.attack.steps for group in plan.tasks.groups()}
    tables["choices"] = table_from_rows("choices", choice_rows(scored, plan.sweep, steps))
    reach_m = max(group.template.placement.max_range_m for group in plan.tasks.groups())
    transfers = _by_effects_requested(tables["transfers"].to_pandas(), plan)
    tables["bev_transfer"] = table_from_rows("bev_transfer", transfer_rows(transfers, reach_m))
    skipped = [{"sweep": plan.sweep, "scene": name, "why": why} for name, why in plan.skipped.items()]
    tables["skipped_scenes"] = table_from_rows("skipped_scenes", skipped)
    for name in sorted(tables, key=lambda name: name == "scores"):
        write_table(folder / "final" / f"{name}.parquet", tables[name])
    for name in FOLLOW_UPS[1:]:
        if (made := folder / "final" / f"{name}.parquet").is_file():
            tables[name] = read_table(made, name)
    return FinalTables(tables)


def with_verification(scores: pa.Table, verification: pa.Table) -> pa.Table:
    """Return the scores with ``score_reference`` and ``stable`` of every verified row; nothing else changes."""
    rows = verification.select([*_VERIFIED_KEY, *_VERIFIED]).to_pylist()
    known = {tuple(row[name] for name in _VERIFIED_KEY): row for row in rows}
    keys = zip(*(scores[name].to_pylist() for name in _VERIFIED_KEY), strict=True)
    found = [known.get(key, {}) for key in keys]
    for name in _VERIFIED:
        place, field = scores.schema.get_field_index(name), scores.schema.field(name)
        scores = scores.set_column(place, field, pa.array([row.get(name) for row in found], type=field.type))
    return scores


def check_segments(folder: LocationLike, entries: Sequence[Commit]) -> None:
    """Read all that `write_final` reads, before work that ends with it. Raises InputError as it does."""
    for name in SWEEP_TABLES:
        committed_rows(folder, entries, name)


def _by_effects_requested(scored: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """Return scores with requested effects; a task of several settings gets a row for each."""
    return scored.assign(effects=plan.tasks.effects_requested_of(scored["task_id"])).explode("effects")


def segments_in_plan_order(folder: LocationLike, entries: Sequence[Commit], name: str, plan: Plan) -> pa.Table:
    """Return all committed rows of one table in plan order; rows of a task keep their order (attempts: by number).

    Raises: InputError: a segment is missing, torn, of another length than was committed, or of another plan.
    """
    table = committed_rows(folder, entries, name)
    positions = plan.tasks.positions_of(table["task_id"], f"data, {name}")
    if name == "attempts":
        order = np.lexsort((table["attempt"].to_numpy(), positions))
    else:
        order = np.argsort(positions, kind="stable")
    return table.take(pa.array(order)).combine_chunks()


def _curve_rows(scored: pd.DataFrame) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for group, members in groups(scored):
        curve = recall_curve(members["score"])
        for threshold, recall in zip(curve.score_threshold.tolist(), curve.recall.tolist()):
            rows.append({**group, "score_threshold": threshold, "recall": recall})
    return rows


def _auc_rows(scored: pd.DataFrame, plan: Plan) -> list[dict[str, Any]]:
    planned = _planned(plan)
    chosen = {key: choice.chosen for key, choice in choose_lambdas(scored).items()}
    rows = []
    for group, members in groups(scored):
        rows.append(
            {
                **group,
                "auc": area_under(recall_curve(members["score"])),
                "scores": len(members),
                "tasks_scored": members["task_id"].nunique(),
                "tasks_planned": planned.get(tuple(group[name] for name in _PLAN_GROUP), (0, []))[0],
                "mean_adversarial_loss": _mean(members["adversarial_loss"]),
                "mean_latent_distance": _mean(members["latent_distance"]),
                "selected": chosen.get(tuple(group[name] for name in RULE_KEYS), group["lambda"]) == group["lambda"],
            }
        )
    return rows + _gaps(rows, planned)


def _mean(values: pd.Series) -> float | None:
    mean = float(values.mean())
    return mean if np.isfinite(mean) else None


_Planned = dict[tuple[Any, ...], tuple[int, list[str]]]


def _planned(plan: Plan) -> _Planned:
    """Return the number of tasks and the methods of each group; draws, noisy copies and edits only if requested."""
    found: _Planned = {}
    for group in plan.tasks.groups():
        spec, attack = group.template, group.template.attack
        optional = {"random": bool(attack.random_replicates), "adversarial_noise": bool(attack.noise_replicates)}
        optional |= {"random_budget": bool(attack.random_search), "edited": bool(attack.edit)}
        known = (plan.sweep, spec.dataset, spec.vehicle, spec.mode, spec.lambda_, spec.alpha, spec.detector)
        for last in itertools.product(group.effects_requested, spec.scored_by):
            key = (*known, spec.accuracy, spec.search, *last)
            count, methods = found.get(key, (0, []))
            methods = [n for n in METHODS_OF_MODE[spec.mode] if n in methods or optional.get(n, True)]
            found[key] = count + group.tasks, methods
    return found


def _gaps(rows: list[dict[str, Any]], planned: _Planned) -> list[dict[str, Any]]:
    """Return rows without an AUC for planned groups without any score, so that a gap is visible."""
    seen = {(*(row[name] for name in _PLAN_GROUP), row["method"]) for row in rows}
    gaps = []
    for key, (count, methods) in planned.items():
        group = dict(zip(_PLAN_GROUP, key))
        for method in methods:
            if (*key, method) not in seen:
                empty = {"scores": 0, "tasks_scored": 0, "tasks_planned": count, "selected": False}
                gaps.append({**group, "method": method, **empty})
    return gaps
