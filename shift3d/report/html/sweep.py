"""A finished sweep as the sections of its report read it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import GROUP_COLUMNS, SCHEMAS
from shift3d.sweep.planning.plan import Plan

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["METHODS", "Sweep", "Variant", "read_sweep", "variants"]

METHODS = {
    "baseline": "baseline",
    "random": "random",
    "adversarial_noise": "adversarial + noise",
    "adversarial": "adversarial",
}
"""Methods in the order of the paper's tables, and what they are called."""
_TABLES = ("scores", "solutions", "auc", "bev", "timings", "attempts")
_LATER = ("trajectories", "bev_transfer", "choices", "shapes")  # tables that sweeps of an earlier program do not have
_VARIANT = ("mode", "detector", "scored_by", "alpha", "accuracy", "effects")
_NAMES = {"detector": "attacked", "scored_by": "scored by", "alpha": "alpha", "accuracy": "accuracy"}


@dataclass(frozen=True)
class Sweep:
    """A sweep's plan and tables.

    environment: what ran it (``env.json``). The others: tables of ``final/``; verification is None where the sweep was
    not verified; trajectories, bev_transfer, choices and shapes are empty where it has none.
    """

    plan: Plan
    environment: dict[str, Any]
    scores: pd.DataFrame
    solutions: pd.DataFrame
    auc: pd.DataFrame
    bev: pd.DataFrame
    timings: pd.DataFrame
    attempts: pd.DataFrame
    trajectories: pd.DataFrame
    bev_transfer: pd.DataFrame
    choices: pd.DataFrame
    shapes: pd.DataFrame
    verification: pd.DataFrame | None = None

    @property
    def scored(self) -> pd.DataFrame:
        """Rows that have a score, with the effects that were asked for (a row for each), and `place`: their scene.

        still_a_car: of the shape that the row's task found; None where it was not looked at.
        """
        rows = self.scores[self.scores["score"].notna()]
        rows = rows.assign(effects=self.plan.tasks.effects_requested_of(rows["task_id"])).explode("effects")
        looked_at = dict(zip(self.shapes["task_id"], self.shapes["still_a_car"].astype(object)))
        cars = rows["task_id"].map(looked_at).astype(object)
        return rows.assign(place=rows["dataset"] + "/" + rows["scene"], still_a_car=cars.where(cars.notna(), None))


@dataclass(frozen=True)
class Variant:
    """What one table of AUC is about.

    mode, detector (attacked), scored_by, alpha, accuracy, effects: the same for all its rows. label: what tells it
    from the sweep's other variants. key: short, without spaces, the same in every run. rows: scores at the lambda that
    the paper's rule chose for each vehicle.
    """

    mode: str
    detector: str
    scored_by: str
    alpha: float
    accuracy: str
    effects: str
    label: str
    key: str
    rows: pd.DataFrame

    @property
    def vehicles(self) -> list[str]:
        """In the order of the plan."""
        return list(dict.fromkeys(self.rows["vehicle"]))

    @property
    def methods(self) -> list[str]:
        """Those that have scores, in the order of the paper's tables."""
        found = set(self.rows["method"])
        return [name for name in METHODS if name in found]


def read_sweep(folder: LocationLike) -> Sweep:
    """Everything that a report is made of.

    Raises:
        InputError: naming the folder or file, where it is no sweep's, has not finished, or is damaged.
    """
    from shift3d.store.tables import read_table
    from shift3d.sweep.planning.folder import read_plan

    folder = as_location(folder)
    plan, final = read_plan(folder), folder / "final"
    if not (final / "scores.parquet").is_file():
        raise InputError("the sweep is not finished", where=str(folder), remedy="Run its command again: it resumes")
    tables = {name: read_table(final / f"{name}.parquet", name).to_pandas() for name in _TABLES}
    for name in _LATER:
        path = final / f"{name}.parquet"
        tables[name] = (read_table(path, name) if path.is_file() else SCHEMAS[name].empty_table()).to_pandas()
    verified = final / "verification.parquet"
    verification = read_table(verified, "verification").to_pandas() if verified.is_file() else None
    return Sweep(plan, _environment(folder / "env.json"), **tables, verification=verification)


def _environment(path: Location) -> dict[str, Any]:
    try:
        values = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        what = f"cannot be read ({type(error).__name__})"
        raise InputError(what, where=str(path), remedy="Restore it from a copy") from error
    if not isinstance(values, dict):
        raise InputError("is not what a sweep wrote", where=str(path), remedy="Restore it from a copy")
    return values


def variants(sweep: Sweep) -> list[Variant]:
    """Shape before pose; of one mode, the attacked detector's own scores before those of others."""
    chosen = sweep.auc[sweep.auc["selected"] & sweep.auc["auc"].notna()][list(GROUP_COLUMNS)].drop_duplicates()
    if chosen.empty:
        return []
    rows = sweep.scored.merge(chosen, on=list(GROUP_COLUMNS), how="inner")
    several = [name for name in _VARIANT[1:] if rows[name].nunique() > 1]
    found = []
    for values, group in rows.groupby(list(_VARIANT), sort=False):
        named = dict(zip(_VARIANT, values))
        label = ", ".join([f"adversarial {named['mode']}", *(_said(name, named[name]) for name in several)])
        found.append((named, label, group))
    found.sort(key=lambda item: (item[0]["mode"] != "shape", item[0]["detector"] != item[0]["scored_by"]))
    return [
        Variant(**named, label=label, key=f"{named['mode']}-{number}", rows=group.reset_index(drop=True))
        for number, (named, label, group) in enumerate(found)
    ]


def _said(name: str, value: object) -> str:
    if name == "effects":
        return "no effects" if value == "none" else f"effects {str(value).replace('_', ' ')}"
    return f"{_NAMES[name]} {value}"
