"""What one table of AUCs is about: a mode, a detector that is attacked and one that scores, and their settings."""

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

SETTINGS = ("alpha", "detector", "scored_by", "accuracy", "search", "effects")
"""What variants of one mode differ in."""


@dataclass(frozen=True)
class Aucs:
    """Areas under threshold-recall curves, by method and then by vehicle."""

    by_method: Mapping[str, Mapping[str, float]]

    def of(self, method: str, vehicle: str) -> float | None:
        """One AUC; None where there is none."""
        return self.by_method.get(method, {}).get(vehicle)

    def mean(self, method: str, vehicles: list[str]) -> float | None:
        """Mean over those of some vehicles that have one: every vehicle counts the same."""
        known = [value for vehicle in vehicles if (value := self.of(method, vehicle)) is not None]
        return math.fsum(known) / len(known) if known else None

    def of_baseline(self, method: str, vehicles: list[str]) -> float | None:
        """The method's mean over the baseline's of the same vehicles."""
        same = [vehicle for vehicle in vehicles if self.of(method, vehicle) is not None]
        if not same or any(self.of("baseline", vehicle) is None for vehicle in same):
            return None
        mean, baseline = self.mean(method, same), self.mean("baseline", same)
        return mean / baseline if baseline and mean is not None else None


def search_label(mode: str, search: str, weight: float, alpha: float, detector: str, settings: str = "") -> str:
    """ "shape, descent, lambda 1, alpha 0.01, pointpillars"; a pose has no lambda. settings: named behind it."""
    shown = "" if math.isnan(weight) else f", lambda {weight:g}"
    named = f", {settings}" if settings else ""
    return f"{mode.replace('_', ' and ')}, {search}{shown}, alpha {alpha:g}, {detector}{named}"


def aucs_of_scores(rows: pd.DataFrame) -> Aucs:
    """AUCs of rows with columns method, vehicle and score: an AUC is the mean score exactly."""
    return _nested(rows.groupby(["method", "vehicle"], sort=False)["score"].mean().items())


def _nested(values: Any) -> Aucs:
    found: dict[str, dict[str, float]] = {}
    for (method, vehicle), value in values:
        found.setdefault(method, {})[vehicle] = float(value)
    return Aucs(found)


def differing_settings(rows: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Of each row, in words, those of some settings that differ among the rows; nothing where none does.

    names: columns; one that the rows do not have says nothing. Effects are a list of names.
    """
    several = [name for name in names if name in rows and rows[name].map(_words).nunique() > 1]
    return [", ".join(map(_words, values)) for values in rows[several].itertuples(index=False)]


def _words(value: str | Sequence[str]) -> str:
    """A setting's value as a line tells it."""
    return label_words(value) if isinstance(value, str) else "+".join(value) or "no effects"


@dataclass(frozen=True)
class Variant:
    """Part of a sweep's results: one mode under one choice of `SETTINGS`.

    Shape results are those of the lambda that the paper's rule chose for each vehicle.

    differing: the settings in which the sweep's variants differ, as texts. vehicles: as planned, scored or not. auc:
    its rows of ``final/auc.parquet`` that have an AUC. rows: the scores behind them, see `Sweep.scored`; empty where
    they were not given. key: short, without spaces, the same in every run.
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
        """What tells it from the sweep's other variants."""
        names = {"detector": "attacked", "scored_by": "scored by"}
        parts = [f"{names.get(name, name)} {label_words(text)}" for name, text in self.differing.items()]
        return ", ".join([f"adversarial {self.mode.replace('_', ' and ')}", *parts]).replace(
            "effects none", "no effects"
        )

    @property
    def title(self) -> str:
        """The label as the beginning of a sentence."""
        return f"{self.label[0].upper()}{self.label[1:]}"

    @property
    def is_own(self) -> bool:
        """Whether the detector that scores is the one that is attacked."""
        return self.detector == self.scored_by

    @cached_property
    def aucs(self) -> Aucs:
        """By method and vehicle; data sets are pooled by their number of scores."""
        weighted = self.auc.assign(sum=self.auc["auc"] * self.auc["scores"])
        sums = weighted.groupby(["method", "vehicle"], sort=False)[["sum", "scores"]].sum()
        return _nested((sums["sum"] / sums["scores"]).items())

    @property
    def lambdas(self) -> dict[str, float]:
        """The chosen lambda by vehicle; empty for poses."""
        first = self.auc[self.auc["lambda"].notna()].drop_duplicates("vehicle")
        return dict(zip(first["vehicle"], first["lambda"]))

    @property
    def methods(self) -> list[str]:
        """Those that have scores, in the order of the paper's tables."""
        return [name for name in METHODS if name in self.aucs.by_method]

    def by_vehicle(self) -> list[tuple[str, pd.DataFrame]]:
        """Rows of each vehicle that has some, and, where there are several, of all together."""
        parts = [(name.replace("_", " "), self.rows[self.rows["vehicle"] == name]) for name in self.vehicles]
        parts = [(name, rows) for name, rows in parts if len(rows)]
        return [*parts, ("all vehicles", self.rows)] if len(parts) > 1 else parts


def variants(auc: pd.DataFrame, scored: pd.DataFrame | None = None) -> list[Variant]:
    """Shape, pose, both together; of one mode, the attacked detector's own scores before those of others.

    auc: the table of ``final/``. scored: `Sweep.scored`, for what is made of single scores.
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
    if scored.empty or selected.empty:  # columns of nothing have no types to merge on
        return scored.iloc[:0]
    groups = selected[list(GROUP_COLUMNS)].drop_duplicates()
    return scored.merge(groups, on=list(GROUP_COLUMNS), how="inner")


def setting_text(value: object) -> str:
    """A setting's value as labels and lines have it."""
    return f"{value:g}" if isinstance(value, float) else str(value)
