"""Scores of real vehicles, fitted to the points of scenes, that resemble a sweep's adversarial shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from shift3d.analysis.results import places_of
from shift3d.analysis.statistics.intervals import mean_interval
from shift3d.analysis.tables.table import Table, interval_text, number
from shift3d.analysis.variants import with_search
from shift3d.errors import InputError
from shift3d.wording import counted

_POINTS = ((10, 30), (30, 100), (100, 300), (300, 1000), (1000, None))
_GROUP = ["search_words", "scored_by"]
_KEY = ["task_id", "scored_by"]


def pool_table(pool: pd.DataFrame) -> Table:
    """Build the table of the vehicle pool by number of points: fitted and flagged vehicles, residual and shape error.

    pool: the table of ``final/``. Errors are medians over all fitted vehicles, flagged or not.
    """
    fitted = pool[pool["status"] == "fitted"]
    lines = [_pool_line("all", fitted)]
    lines += [
        _pool_line(f"{low} to {high - 1} points" if high else f"{low} points and more", rows)
        for low, high in _POINTS
        if len(rows := fitted[(fitted["points"] >= low) & ((fitted["points"] < high) if high else True)])
    ]
    for flag in sorted({name for flags in fitted["flags"] for name in flags}):
        lines.append(_pool_line(f"flagged {flag}", fitted[[flag in flags for flags in fitted["flags"]]]))
    refused = pool["status"][pool["status"] != "fitted"].value_counts().sort_index()
    left_out = ", ".join(f"{name} {count}" for name, count in refused.items()) or "none"
    scenes = len(pool[["dataset", "scene"]].drop_duplicates())
    title = f"Labelled vehicles of {counted(scenes, 'scene')}: {len(fitted)} fitted, "
    title += f"{len(pool) - len(fitted)} refused ({left_out})"
    header = ["", "fitted", "usable", "residual, cm", "shape error, cm", "90 %", "mean vehicle's, cm", "score"]
    return Table(title, header, lines)


def _pool_line(name: str, rows: pd.DataFrame) -> list[str]:
    usable = sum(not len(flags) for flags in rows["flags"])
    error = rows["shape_error_cm"]
    errors = [error.median(), error.quantile(0.9), rows["mean_shape_error_cm"].median()]
    centimetres = [number(value, 1) for value in (rows["residual_cm"].median(), *errors)]
    return [name, str(len(rows)), str(usable), *centimetres, number(rows["score"].mean(), 2)]


def kept(retrieved: pd.DataFrame) -> pd.DataFrame:
    """Select one row per solution and detector that the paper's rule does not exclude, with `place` and control means.

    retrieved: the table of ``final/``. control, control_in_log: mean scores of the controls, if there are any.
    log_place: place of the retrieved vehicle's own scene.
    """
    rows = retrieved[~retrieved["excluded"].astype(bool)]
    controls = controls_of(retrieved).groupby(_KEY)[["score", "pool_score"]].mean()
    controls = controls.rename(columns={"score": "control", "pool_score": "control_in_log"})
    found = rows[rows["role"] == "retrieved"].merge(controls.reset_index(), on=_KEY, how="left")
    return found.assign(place=places_of(found), log_place=places_of(found, "pool_dataset", "pool_scene"))


def controls_of(retrieved: pd.DataFrame) -> pd.DataFrame:
    """Select one row per control and detector, for the solutions of `kept`."""
    return retrieved[(retrieved["role"] == "control") & ~retrieved["excluded"].astype(bool)]


def pool_vehicle_of(pool: pd.DataFrame, row: Mapping[str, Any]) -> pd.Series:
    """Return the pool vehicle of a row of ``retrieved``. Raises InputError: the pool lacks this vehicle."""
    key = ["dataset", "scene", "label"]
    found = pool[(pool[key] == [row[f"pool_{name}"] for name in key]).all(axis=1)]
    if found.empty:
        what = f"holds no vehicle {row['pool_label']} of {row['pool_dataset']}/{row['pool_scene']}"
        raise InputError(what, "vehicle_pool.parquet", "Run shift3d retrieve again: it resumes")
    return found.iloc[0]


@dataclass(frozen=True)
class NaturalKinGroup:
    """Natural kin (nearest real vehicles) of one search. rows: see `kept`. solutions: number of all solutions."""

    label: str
    scored_by: str
    rows: pd.DataFrame
    solutions: int

    @property
    def matched(self) -> pd.DataFrame:
        """Rows that have controls."""
        return self.rows[self.rows["control"].notna()]

    @property
    def means(self) -> dict[str, float]:
        """Mean scores of baseline, adversarial shape, retrieved vehicle and controls; NaN for missing controls."""
        columns = {"baseline": "score_baseline", "shape": "score_solution", "retrieved": "score"}
        means = {name: float(self.rows[column].mean()) for name, column in columns.items()}
        return means | {"controls": float(self.matched["control"].mean())}


def retrieval_groups(retrieved: pd.DataFrame) -> list[NaturalKinGroup]:
    """Group the kin that the paper's rule keeps by search and scoring detector.

    retrieved: the table of ``final/``, with `with_effects_requested` if effects may differ.
    """
    retrieved = with_search(retrieved.explode("effects") if "effects" in retrieved else retrieved)
    counts = retrieved[retrieved["role"] == "retrieved"].groupby(_GROUP).size()
    groups = kept(retrieved).groupby(_GROUP, sort=False)
    return [NaturalKinGroup(label, by, rows, int(counts.loc[label, by])) for (label, by), rows in groups]


def retrieval_table(retrieved: pd.DataFrame) -> Table | None:
    """Build the table of mean scores and paired differences with intervals, one line per search and scoring detector.

    Differences are per solution. Both the solutions' scenes and the retrieved vehicles' scenes are random draws,
    because one vehicle may be the nearest to many shapes. "in the log": scores of the pool's detector at the vehicles'
    original places, scenes of the pool redrawn. Returns None if nothing was retrieved.
    """
    if retrieved.empty:
        return None
    lines = []
    for group in retrieval_groups(retrieved):
        rows, matched = group.rows, group.matched
        line = [group.label, group.scored_by, f"{len(rows)} of {group.solutions}"]
        line += [number(mean, 3) for mean in group.means.values()]
        line.append(_mean(rows["score"] - rows["score_baseline"], rows["place"], rows["log_place"]))
        line.append(_mean(matched["score"] - matched["control"], matched["place"], matched["log_place"]))
        in_log = matched.drop_duplicates(["pool_dataset", "pool_scene", "pool_label"])
        line.append(_mean(in_log["pool_score"] - in_log["control_in_log"], in_log["log_place"]))
        lines.append(line)
    if not lines:
        return Table("No vehicle of the pool is near enough to a shape", ["", "retrieved"], [["", "0"]])
    header = ["", "scored by", "near enough", "baseline", "shape", "retrieved", "controls"]
    header += ["retrieved less baseline", "retrieved less controls", "the same in the log"]
    return Table("Natural kin at the places of the shapes", header, lines)


def _mean(values: pd.Series, places: pd.Series, others: pd.Series | None = None) -> str:
    return interval_text(mean_interval(values, places, others) if len(values) else None, 3)
