"""Variants of a sweep: each combines a mode, an attacked detector, a scoring detector and their settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from shift3d.methods import METHODS, METHODS_OF_MODE
from shift3d.store.schemas import GROUP_COLUMNS
from shift3d.task.spec import label_words

# Settings in which variants of one mode differ.
SETTINGS = ("alpha", "detector", "scored_by", "accuracy", "search", "effects")


@dataclass(frozen=True)
class Aucs:
    """Areas under threshold-recall curves, by method and then by vehicle."""

    by_method: Mapping[str, Mapping[str, float]]

    def of(self, method: str, vehicle: str) -> float | None:
        """Return one AUC, or None if it does not exist."""
        return self.by_method.get(method, {}).get(vehicle)

    def mean(self, method: str, vehicles: list[str]) -> float | None:
        """Return the unweighted mean over the vehicles that have an AUC, or None."""
        known = [value for vehicle in vehicles if (value := self.of(method, vehicle)) is not None]
        return math.fsum(known) / len(known) if known else None

    def ratio_to_baseline(self, method: str, vehicles: list[str]) -> float | None:
        """Return the method's mean over the baseline's mean of the same vehicles, or None."""
        same = [vehicle for vehicle in vehicles if self.of(method, vehicle) is not None]
        if not same or any(self.of("baseline", vehicle) is None for vehicle in same):
            return None
        mean, baseline = self.mean(method, same), self.mean("baseline", same)
        return mean / baseline if baseline and mean is not None else None


def search_label(mode: str, search: str, weight: float, alpha: float, detector: str, settings: str = "") -> str:
    """Format a search: "shape, descent, lambda 1, alpha 0.01, pointpillars, SETTINGS". A pose has no lambda."""
    shown = "" if math.isnan(weight) else f", lambda {weight:g}"
    named = f", {settings}" if settings else ""
    return f"{mode.replace('_', ' and ')}, {search}{shown}, alpha {alpha:g}, {detector}{named}"


def with_search(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows with the column search_words: each row's search as `search_label` formats it.

    Accuracy and effects are named if they differ among the rows.
    """
    keys = (rows[name] for name in ("mode", "search", "lambda", "alpha", "detector"))
    settings = differing_settings(rows, ("accuracy", "effects"))
    return rows.assign(search_words=[search_label(*row) for row in zip(*keys, settings)])


def aucs_of_scores(rows: pd.DataFrame) -> Aucs:
    """Compute AUCs from the columns method, vehicle and score: an AUC equals the mean score exactly."""
    return _nested(rows.groupby(["method", "vehicle"], sort=False)["score"].mean().items())


def _nested(values: Any) -> Aucs:
    found: dict[str, dict[str, float]] = {}
    for (method, vehicle), value in values:
        found.setdefault(method, {})[vehicle] = float(value)
    return Aucs(found)


def differing_settings(rows: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Describe, row by row, the settings that differ among the rows; empty texts if none differs.

    names: columns; names that the rows lack are skipped. Effects are a requested setting or a list of names.
    """
    several = [name for name in names if name in rows and rows[name].map(_words).nunique() > 1]
    return [", ".join(map(_words, values)) for values in rows[several].itertuples(index=False)]


def _words(value: str | Sequence[str]) -> str:
    if isinstance(value, str):
        return "no effects" if value == "none" else label_words(value)
    return "+".join(value) or "no effects"


@dataclass(frozen=True)
class Variant:
    """Part of a sweep's results: one mode with one value for each of `SETTINGS`.

    Shape results use the lambda that the paper's rule chose for each vehicle.

    differing: the settings in which the sweep's variants differ, as texts. vehicles: as planned, scored or not. auc:
    the variant's rows of ``final/auc.parquet`` that have an AUC. rows: the scores behind these AUCs, see
    `Sweep.scored`; empty if not given. key: short identifier without spaces, the same in every run.
    """

    mode: str
    alpha: float
    detector: str
    scored_by: str
    accuracy: str
    search: str
    effects: str
    differing: Mapping[str, str]
    vehicles: list[str]
    auc: pd.DataFrame
    rows: pd.DataFrame
    key: str

    @property
    def label(self) -> str:
        """Description that distinguishes the variant from the sweep's other variants."""
        names = {"detector": "attacked", "scored_by": "scored by"}
        parts = [f"{names.get(name, name)} {label_words(text)}" for name, text in self.differing.items()]
        return ", ".join([f"adversarial {self.mode.replace('_', ' and ')}", *parts]).replace(
            "effects none", "no effects"
        )

    @property
    def title(self) -> str:
        """Label with a capital letter, for the beginning of a sentence."""
        return f"{self.label[0].upper()}{self.label[1:]}"

    @property
    def scores_itself(self) -> bool:
        """True if the scoring detector is the attacked detector."""
        return self.detector == self.scored_by

    @cached_property
    def aucs(self) -> Aucs:
        """AUCs by method and vehicle; data sets are weighted by their number of scores."""
        weighted = self.auc.assign(sum=self.auc["auc"] * self.auc["scores"])
        sums = weighted.groupby(["method", "vehicle"], sort=False)[["sum", "scores"]].sum()
        return _nested((sums["sum"] / sums["scores"]).items())

    @property
    def lambdas(self) -> dict[str, float]:
        """Chosen lambda by vehicle; empty for poses."""
        first = self.auc[self.auc["lambda"].notna()].drop_duplicates("vehicle")
        return dict(zip(first["vehicle"], first["lambda"]))

    @property
    def methods(self) -> list[str]:
        """Methods that have scores, in the order of the paper's tables."""
        return [name for name in METHODS if name in self.aucs.by_method]

    def by_vehicle(self) -> list[tuple[str, pd.DataFrame]]:
        """Return the rows of each vehicle that has rows, and of all vehicles together if there are several."""
        parts = [(name.replace("_", " "), self.rows[self.rows["vehicle"] == name]) for name in self.vehicles]
        parts = [(name, rows) for name, rows in parts if len(rows)]
        return [*parts, ("all vehicles", self.rows)] if len(parts) > 1 else parts


def variants(auc: pd.DataFrame, scored: pd.DataFrame | None = None) -> list[Variant]:
    """Split results into variants: shape, pose, then both; within a mode the attacked detector's own scores come first.

    auc: the table of ``final/``. scored: `Sweep.scored`, for results that need single scores.
    """
    several = [name for name in SETTINGS if auc[name].nunique() > 1]
    found = []
    for values, group in auc.groupby(["mode", *SETTINGS], sort=False):
        named = dict(zip(("mode", *SETTINGS), values))
        selected = group[group["selected"] & group["auc"].notna()]
        rows = selected.iloc[:0] if scored is None else _behind(selected, scored)
        found.append((named, {name: setting_text(named[name]) for name in several}, group, selected, rows))
    order = list(METHODS_OF_MODE)
    found.sort(key=lambda item: (order.index(item[0]["mode"]), item[0]["detector"] != item[0]["scored_by"]))
    return [
        Variant(**named, differing=texts, vehicles=list(dict.fromkeys(group["vehicle"])), auc=selected, rows=rows,
                key=f"{named['mode']}-{number}")
        for number, (named, texts, group, selected, rows) in enumerate(found)
    ]  # fmt: skip


def _behind(selected: pd.DataFrame, scored: pd.DataFrame) -> pd.DataFrame:
    if scored.empty or selected.empty:  # columns of empty frames have no types to merge on
        return scored.iloc[:0]
    groups = selected[list(GROUP_COLUMNS)].drop_duplicates()
    return scored.merge(groups, on=list(GROUP_COLUMNS), how="inner")


def setting_text(value: object) -> str:
    """Format a setting's value for labels and table lines."""
    return f"{value:g}" if isinstance(value, float) else str(value)
