"""Measured impact of each effect: change of scores and AUC against its cost in milliseconds.

The tables must be those of a sweep that ran the same tasks without effects and with one effect at a time
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
from shift3d.analysis.tables.table import Table, interval_text, number
from shift3d.effects.applicability import IMPACT_BOUND, NEEDS, MeasuredImpact
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic

# Fewest scenes for `effects=auto`. Source: our choice: with 8 scenes the 95 % intervals cover in 88 % of the cases.
LEAST_SCENES = 8

_OBJECT = ["vehicle", "dataset", "scene", "detector", "accuracy", *PLACE]
_PAIR = [*_OBJECT, "mode", "lambda", "alpha", "search", "scored_by", "method", "replicate"]
MEANINGS = {
    "|change|": "mean absolute change of the unchanged vehicle's score, with its 95 % interval (scenes resampled)",
    "AUC": "change of the mean score of the baseline and of the adversarial object (searched again under the effect), "
    "with its 95 % interval",
    "ms": "extra time of one rendering, without work that is done once for a scene",
    "auto": f"whether effects=auto takes the effect: yes unless the interval of |change| is below {IMPACT_BOUND:g}",
}


@dataclass(frozen=True)
class EffectImpact:
    """Impact of one effect against no effect, over the same objects. score_change: mean |change| of the baseline's
    score. auc_baseline, auc_adversarial: change of the mean score. milliseconds: extra time of a rendering, or NaN."""

    effect: str
    scenes: int
    objects: int
    score_change: Interval
    auc_baseline: Interval
    auc_adversarial: Interval | None
    milliseconds: float

    @property
    def measured(self) -> MeasuredImpact:
        """Impact in the form that `effects=auto` reads."""
        change = self.score_change
        return MeasuredImpact(change.mean, change.low, change.high, self.milliseconds)


def effect_impacts(scores: pd.DataFrame, milliseconds: Mapping[str, float]) -> list[EffectImpact]:
    """Compute the impact of every effect that ran alone, in physical order.

    Args: scores: the table of ``final/``. milliseconds: see `effect_milliseconds`.

    Raises: InputError: no task ran without effects, or none with a single effect.
    """
    # Scores of the attacked detector only: the reaction of other detectors says nothing about it.
    own = scores["score"].notna() & (scores["scored_by"] == scores["detector"])
    scored = _by_effect(scores[own & scores["method"].isin(["baseline", "adversarial"])])
    plain = scored[scored["effect"] == ""]
    found = [name for name in NEEDS if (scored["effect"] == name).any()]
    if plain.empty or not found:
        remedy = "Run sweeps/effects.yaml: shift3d sweep effects"
        raise InputError("no tasks without effects beside tasks with exactly one effect", "the sweep", remedy)
    return [_impact(name, scored[scored["effect"] == name], plain, milliseconds.get(name, nan)) for name in found]


def _by_effect(scores: pd.DataFrame) -> pd.DataFrame:
    """Add each row's effects and the place of its vehicle; replicates differ only in their place."""
    return with_places(scores).assign(effect=scores["effects"].map(lambda names: "+".join(names)))


def _impact(name: str, with_effect: pd.DataFrame, plain: pd.DataFrame, milliseconds: float) -> EffectImpact:
    if with_effect.duplicated(_PAIR).any() or plain.duplicated(_PAIR).any():
        what = "tasks differ in settings that the tables do not hold, so objects have several partners"
        raise InputError(what, "the sweep", "Run it with one value of every other setting")
    pairs = with_effect.merge(plain, on=_PAIR, suffixes=("", "_plain"))
    if pairs.empty:
        raise InputError(
            f"no object was scored both with {name} and without it", "the sweep", "Run both on the same scenes"
        )
    # Tasks of several modes, lambdas or alphas share one baseline.
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
    """Compute the extra time of rendering a baseline by effect: median over objects also rendered without the effect.

    scores, timings: tables of ``final/``. The time includes the effect itself and any slowdown of other stages.
    """
    own = timings[(timings["method"] == "baseline") & timings["stage"].str.match(r"render$|effect_")]
    spent = own.groupby("task_id")["milliseconds"].sum().rename("spent")
    tasks = _by_effect(scores).drop_duplicates("task_id").merge(spent, left_on="task_id", right_index=True)
    # unstack, not a pivot that keeps empty cells: that would create every combination of places. Only one of the tasks
    # that share a baseline has its time, and under another effect this may be another task.
    of_object = tasks.groupby([*_OBJECT, "effect"])["spent"].mean().unstack("effect")
    of_object = of_object.dropna(subset=[""]) if "" in of_object else of_object.assign(**{"": nan})
    return {str(name): float((of_object[name] - of_object[""]).median()) for name in of_object if name != ""}


def effect_table(impacts: Sequence[EffectImpact]) -> Table:
    """Build the table with one line per effect."""
    lines = [
        [
            impact.effect.replace("_", " "),
            str(impact.scenes),
            str(impact.objects),
            interval_text(impact.score_change, 3, ""),
            interval_text(impact.auc_baseline, 3),
            interval_text(impact.auc_adversarial, 3),
            number(impact.milliseconds, 0),
            "yes" if impact.measured.matters else "left out",
        ]
        for impact in impacts
    ]
    header = ["effect", "scenes", "objects", "|change| of baseline score", "AUC baseline", "AUC adversarial", "ms",
              "auto"]  # fmt: skip
    kinds = ["ours" if impact.measured.matters else "dominated" for impact in impacts]
    return Table("Measured impact of effects", header, lines, kinds)


def write_impact(path: Path, sweep: str, impacts: list[EffectImpact]) -> Path:
    """Write the JSON that ``effects=auto`` reads, see `effects.applicability.MEASURED_IMPACT`. Returns its path."""
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
