"""Finished sweep, as tables, figures and pages read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from shift3d.scenes.sets import independent_group_of
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMAS
from shift3d.store.tables import read_final
from shift3d.sweep.planning.folder import read_environment, read_plan
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.tasks import Tasks

_TABLES = ("scores", "solutions", "auc", "bev", "timings", "attempts")
# Tables that folders of older versions do not have.
_LATER = (
    "trajectories", "transfers", "bev_transfer", "choices", "shapes", "vehicle_pool", "retrieved", "patterns",
)  # fmt: skip
# Pose of a row's vehicle at placement; equal bit for bit under any effects and beams.
PLACE = ["baseline_x_m", "baseline_y_m", "baseline_yaw_rad"]


@dataclass(frozen=True)
class Sweep:
    """Plan and tables of a sweep.

    environment: content of ``env.json``, which records the program and machine. The other attributes are tables of
    ``final/``; retrieved and verification have the column of `with_effects_requested` as well. verification is None if
    the sweep was not verified. trajectories, transfers, bev_transfer, choices, shapes, vehicle_pool, retrieved and
    patterns are empty if the sweep has none.
    """

    plan: Plan
    environment: Mapping[str, Any]
    scores: pd.DataFrame
    solutions: pd.DataFrame
    auc: pd.DataFrame
    bev: pd.DataFrame
    timings: pd.DataFrame
    attempts: pd.DataFrame
    trajectories: pd.DataFrame
    transfers: pd.DataFrame
    bev_transfer: pd.DataFrame
    choices: pd.DataFrame
    shapes: pd.DataFrame
    vehicle_pool: pd.DataFrame
    retrieved: pd.DataFrame
    patterns: pd.DataFrame
    verification: pd.DataFrame | None = None

    @property
    def scored(self) -> pd.DataFrame:
        """Rows with a score, one per requested effects setting, with `place` and `natural` (None if not measured)."""
        rows = self.scores[self.scores["score"].notna()]
        rows = with_effects_requested(rows, self.plan.tasks).explode("effects")
        natural = rows["task_id"].map(self.verdicts).astype(object)
        return rows.assign(place=places_of(rows), natural=natural.where(natural.notna(), None))

    @cached_property
    def verdicts(self) -> dict[str, bool]:
        """Naturalness of the adversarial shape by task, for the tasks where it was measured."""
        return natural_by_task(self.scores)

    @property
    def unnatural(self) -> set[str]:
        """Tasks whose adversarial shape is unnatural."""
        return {task for task, natural in self.verdicts.items() if not natural}

    def pair_of(self, task_id: str) -> list[pd.Series]:
        """Return a task's rows of ``solutions``: baseline and adversarial object. The task must have solutions."""
        rows = self.solutions[(self.solutions["task_id"] == task_id) & (self.solutions["replicate"] == 0)]
        return [rows[rows["method"] == method].iloc[0] for method in ("baseline", "adversarial")]

    def vehicle_words(self, task_id: str) -> str:
        """Return "sedan", or "sedan to camper" if the search ended at another kind. The task must have solutions."""
        before, after = self.pair_of(task_id)
        kinds = [before["vehicle"], after["drawn_as"]]
        return " to ".join(str(kind).replace("_", " ") for kind in kinds if pd.notna(kind))


def places_of(rows: pd.DataFrame, dataset: str = "dataset", scene: str = "scene") -> pd.Series:
    """Return the independent group of each row's scene, the unit that intervals resample; see `independent_group_of`.

    dataset, scene: names of the columns.
    """
    pairs = list(zip(rows[dataset], rows[scene]))
    known = {pair: independent_group_of(*pair) for pair in dict.fromkeys(pairs)}
    return pd.Series([known[pair] for pair in pairs], index=rows.index, dtype=object)


def natural_by_task(scores: pd.DataFrame) -> dict[str, bool]:
    """Return the naturalness of the adversarial shape by task, for tasks with a new shape that was measured."""
    if "natural" not in scores:
        return {}
    found = scores[(scores["method"] == "adversarial") & (scores["mode"] != "pose") & scores["natural"].notna()]
    found = found[found["best_step"] != 0]  # at step 0 the shape is the baseline's
    return {str(task): bool(natural) for task, natural in zip(found["task_id"], found["natural"])}


def with_effects_requested(rows: pd.DataFrame, tasks: Tasks) -> pd.DataFrame:
    """Return rows with the column effects: the list of the requested settings that lead to the row's task."""
    return rows.assign(effects=tasks.effects_requested_of(rows["task_id"]))


def with_places(scores: pd.DataFrame) -> pd.DataFrame:
    """Return rows of ``scores`` with the columns `PLACE` of their task's baseline, NaN without a baseline."""
    base = scores[scores["method"] == "baseline"].drop_duplicates("task_id").set_index("task_id")
    places = {name: scores["task_id"].map(base[name.removeprefix("baseline_")]) for name in PLACE}
    return scores.assign(**places)


def sweep_of(plan: Plan, tables: Mapping[str, pd.DataFrame], environment: Mapping[str, Any]) -> Sweep:
    """Build a sweep from its tables of ``final/``."""
    later = {name: tables[name] if name in tables else SCHEMAS[name].empty_table().to_pandas() for name in _LATER}
    own = {name: tables[name] for name in _TABLES}
    later["retrieved"] = with_effects_requested(later["retrieved"], plan.tasks)
    verified = with_effects_requested(tables["verification"], plan.tasks) if "verification" in tables else None
    return Sweep(plan, environment, **own, **later, verification=verified)


def read_sweep(folder: LocationLike) -> Sweep:
    """Read the sweep of an output folder. Raises InputError: names what is no sweep's, unfinished or damaged."""
    folder = as_location(folder)
    plan, final = read_plan(folder), folder / "final"
    # A driver that finishes meanwhile writes scores last, so it is read first.
    tables = {name: read_final(folder, name).to_pandas() for name in _TABLES}
    later = [name for name in (*_LATER, "verification") if (final / f"{name}.parquet").is_file()]
    tables |= {name: read_final(folder, name).to_pandas() for name in later}
    return sweep_of(plan, tables, read_environment(folder))
