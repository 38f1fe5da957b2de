"""The measured impact of each effect: how far it moves scores and AUC, against its milliseconds.

Made from the tables of a sweep that ran the same tasks without effects and with one of them at a time
(``sweeps/effects.yaml``): the same vehicle at the same place of the same scene, so that differences are paired.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import pandas as pd

from shift3d.analysis.results import PLACE, places_of, with_places
from shift3d.analysis.statistics.intervals import Interval, mean_interval
from shift3d.analysis.tables.table import Table, interval_text
from shift3d.effects.applicability import IMPACT_BOUND, NEEDS, MeasuredImpact
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic

LEAST_SCENES = 8
"""Fewer say too little for `auto` to go by (our choice: at 8 the intervals hold in 88 % of the cases, not in 95 %)."""

_OBJECT = ["vehicle", "dataset", "scene", "detector", "accuracy", *PLACE]
_PAIR = [*_OBJECT, "mode", "lambda", "alpha", "search", "scored_by", "method", "replicate"]
MEANINGS = {
    "|change|": "mean absolute change of the unchanged vehicle's score, with its 95 % interval (scenes resampled)",
    "AUC": "change of the mean score, baseline and adversarial (searched again under the effect), likewise",
    "ms": "what one rendering costs more; what is done once for a scene is not in it",
    "auto": f"whether the change cannot be said to lie below {IMPACT_BOUND:g}: only then does effects=auto take it",
}


@dataclass(frozen=True)
class EffectImpact:
    """One effect against none, over the same objects.

    score_change: mean |change| of the baseline's score. auc_baseline, auc_adversarial: change of the mean score.
    milliseconds: a rendering, more.
    """

    effect: str
    scenes: int
    objects: int
    score_change: Interval
    auc_baseline: Interval
    auc_adversarial: Interval | None
    milliseconds: float

    @property
    def measured(self) -> MeasuredImpact:
        """As `effects=auto` reads it."""
        change = self.score_change
        return MeasuredImpact(change.mean, change.low, change.high, self.milliseconds)


def effect_impacts(scores: pd.DataFrame, milliseconds: Mapping[str, float]) -> list[EffectImpact]:
    """Every effect that ran alone, in the order of the physics.

    Args: scores: the table of ``final/``. milliseconds: see `effect_milliseconds`.

    Raises: InputError: no task ran without effects, or none with one of them.
    """
    # Before the attacked detector: what others make of an effect says nothing of that one.
    own = scores["score"].notna() & (scores["scored_by"] == scores["detector"])
    scored = _by_effect(scores[own & scores["method"].isin(["baseline", "adversarial"])])
    plain = scored[scored["effect"] == ""]
    found = [name for name in NEEDS if (scored["effect"] == name).any()]
    if plain.empty or not found:
        remedy = "Run sweeps/effects.yaml: make sweep SWEEP=effects"
        raise InputError("no tasks with and without one effect", "the sweep", remedy)
    return [_impact(name, scored[scored["effect"] == name], plain, milliseconds.get(name, nan)) for name in found]


def _by_effect(scores: pd.DataFrame) -> pd.DataFrame:
    """With what a row's task ran under, and where its vehicle stands: replicates differ in their place alone."""
    return with_places(scores).assign(effect=scores["effects"].map(lambda names: "+".join(names)))


def _impact(name: str, with_effect: pd.DataFrame, plain: pd.DataFrame, milliseconds: float) -> EffectImpact:
    if with_effect.duplicated(_PAIR).any() or plain.duplicated(_PAIR).any():
        what = "tasks differ in more than effects, places and what the tables hold: no object has one partner"
        raise InputError(what, "the sweep", "Run it with one value of every other setting")
    pairs = with_effect.merge(plain, on=_PAIR, suffixes=("", "_plain"))
    if pairs.empty:
        raise InputError(
            f"no object was scored both with {name} and without", "the sweep", "Run both on the same scenes"
        )
    # Tasks of several modes, lambdas or alphas share a baseline.
    pairs = pairs[~(pairs["method"].eq("baseline") & pairs.duplicated([*_OBJECT, "method"]))]
    change = pairs["score"] - pairs["score_plain"]
    scene = places_of(pairs)
    base, hard = pairs["method"] == "baseline", pairs["method"] == "adversarial"
    return EffectImpact(
        effect=name,
        scenes=scene[base].nunique(),
        objects=int(base.sum()),
        score_change=mean_interval(change[base].abs(), list(scene[base])),
        auc_baseline=mean_interval(change[base], list(scene[base])),
        auc_adversarial=mean_interval(change[hard], list(scene[hard])) if hard.any() else None,
        milliseconds=milliseconds,
    )


def effect_milliseconds(scores: pd.DataFrame, timings: pd.DataFrame) -> dict[str, float]:
    """Effect to what a rendering of a baseline costs more: median over the objects that were also rendered without.

    scores, timings: tables of ``final/``. What the effect itself takes, and what else becomes dearer, are both in it.
    """
    own = timings[(timings["method"] == "baseline") & timings["stage"].str.match(r"render$|effect_")]
    spent = own.groupby("task_id")["milliseconds"].sum().rename("spent")
    tasks = _by_effect(scores).drop_duplicates("task_id").merge(spent, left_on="task_id", right_index=True)
    # Not a pivot that keeps empty cells: it would make every combination of places. Of tasks that share a baseline one
    # has its time, and under another effect that may be another one.
    of_object = tasks.groupby([*_OBJECT, "effect"])["spent"].mean().unstack("effect")
    of_object = of_object.dropna(subset=[""]) if "" in of_object else of_object.assign(**{"": nan})
    return {str(name): float((of_object[name] - of_object[""]).median()) for name in of_object if name != ""}


def effect_table(impacts: Sequence[EffectImpact]) -> Table:
    """A line an effect."""
    lines = [
        [
            impact.effect.replace("_", " "),
            str(impact.scenes),
            str(impact.objects),
            interval_text(impact.score_change, 3, ""),
            interval_text(impact.auc_baseline, 3),
            interval_text(impact.auc_adversarial, 3),
            f"{impact.milliseconds:.0f}",
            "yes" if impact.measured.matters else "left out",
        ]
        for impact in impacts
    ]
    header = ["effect", "scenes", "objects", "|change| of baseline score", "AUC baseline", "AUC adversarial", "ms",
              "auto"]  # fmt: skip
    kinds = ["ours" if impact.measured.matters else "dominated" for impact in impacts]
    return Table("Measured impact of effects", header, lines, kinds)


def write_impact(path: Path, sweep: str, impacts: list[EffectImpact]) -> Path:
    """What ``effects=auto`` reads, as JSON (`effects.applicability.MEASURED_IMPACT` tells where). Returns its path."""
    rows = {
        impact.effect: {
            "score_change": round(impact.score_change.mean, 5),
            "low": round(impact.score_change.low, 5),
            "high": round(impact.score_change.high, 5),
            "milliseconds": round(impact.milliseconds, 1),
            "scenes": impact.scenes,
            "objects": impact.objects,
        }
        for impact in impacts
    }
    write_atomic(path, (json.dumps({"sweep": sweep, "bound": IMPACT_BOUND, "effects": rows}, indent=2) + "\n").encode())
    return path
