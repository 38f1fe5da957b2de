"""Table of a fine-tuning's results: AUC and AP of every model, and gains over vanilla."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from shift3d.analysis.statistics.intervals import mean_interval
from shift3d.evaluation.breakdown import AveragePrecisionDraws
from shift3d.evaluation.intervals import interval
from shift3d.store.schemas import schema_of_columns

VANILLA, TUNED = "vanilla", "finetuned"
ADAPTIVE = "adversarial_adaptive"
_KEY = ["vehicle", "place", "settings"]

# model: vanilla, finetuned, or control (tuned on the unchanged vehicles of the same tasks). seed: of the tuning; null:
# vanilla, or the mean over seeds. objects: baseline | adversarial (found against vanilla) | adversarial_adaptive (found
# against this model); null: labels. scene_set: held_out | other_vehicles | natural. metric: auc | AP BEV | AP 3D |
# APH BEV | APH 3D. low, high: 95 %, scenes resampled; null: a single scene. gain: over vanilla, on the same objects;
# null: vanilla. number: of objects, or of labelled vehicles.
FINETUNE = schema_of_columns(
    "finetune",
    1,
    "model seed:int64? objects? scene_set metric value:float64 low:float64? high:float64? gain:float64? "
    "gain_low:float64? gain_high:float64? number:int64 scenes:int64?",
)
"""One row per model, seed, kind of objects, set of scenes and metric."""


def finetune_table(scores: pd.DataFrame, natural: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Make the table of every AUC and of the natural metrics.

    scores: one row per object: model, seed (NaN: none), scene_set, objects, vehicle, place, settings, score. An AUC is
    the mean score. A gain is a paired difference over the objects that both models scored, with scenes resampled.
    natural: rows of `natural_rows`.
    """
    rows = [*_aucs(scores), *natural]
    return pa.Table.from_pylist([{name: row.get(name) for name in FINETUNE.names} for row in rows], schema=FINETUNE)


def seed_means(scores: pd.DataFrame) -> pd.DataFrame:
    """Average the scores of tuned models over seeds, object by object; objects that a seed lacks are left out.

    Objects with equal `_KEY`, as under several attack.starts, count as one.
    """
    tuned = scores[scores["seed"].notna()]
    if tuned.empty:
        return tuned
    grouped = tuned.groupby(["model", "scene_set", "objects", *_KEY], sort=False)
    seeds = tuned.groupby("model")["seed"].nunique()
    means = grouped.agg(score=("score", "mean"), seeds=("seed", "nunique")).reset_index()
    whole = means["seeds"] == means["model"].map(seeds)
    return means[whole].drop(columns="seeds").assign(seed=np.nan)


def _aucs(scores: pd.DataFrame) -> Iterator[dict[str, Any]]:
    everything = pd.concat([scores, seed_means(scores)], ignore_index=True)
    vanilla = scores[scores["model"] == VANILLA]
    keys = ["model", "seed", "scene_set", "objects"]
    for (model, seed, scene_set, objects), own in everything.groupby(keys, sort=False, dropna=False):
        row = {"model": model, "seed": None if np.isnan(seed) else int(seed), "objects": objects}
        row |= {"scene_set": scene_set, "metric": "auc", "number": len(own), "scenes": own["place"].nunique()}
        row |= _interval("", own["score"], own["place"])
        before = vanilla[(vanilla["scene_set"] == scene_set) & (vanilla["objects"] == objects)]
        if model != VANILLA:
            once = before.groupby(_KEY, sort=False, as_index=False)["score"].mean()
            both = own.merge(once, on=_KEY, suffixes=("", "_before"))
            row |= _interval("gain", both["score"] - both["score_before"], both["place"]) if len(both) else {}
        yield row


def _interval(name: str, values: pd.Series, places: pd.Series) -> dict[str, float | None]:
    found = mean_interval(values, list(places))
    low, high = (end if np.isfinite(end) else None for end in (found.low, found.high))
    return _columns(name, found.mean, low, high)


def natural_rows(
    areas: Mapping[tuple[str, int | None], Mapping[tuple[str, str], AveragePrecisionDraws]],
) -> list[dict[str, Any]]:
    """Return AP and APH of every model as rows of `FINETUNE`, gains paired over the same resampled scenes.

    areas: `evaluation.breakdown.overall_areas` by model and seed, vanilla included, of the same scenes. A metric that
    some model lacks, as of scenes without a vehicle, is left out.
    """
    models = dict.fromkeys(model for model, seed in areas if seed is not None)
    groups = {key: [key] for key in areas}
    groups |= {(model, None): [key for key in areas if key[0] == model] for model in models}
    rows = []
    for (model, seed), keys in groups.items():
        for measure, view in areas[VANILLA, None]:
            own = [areas[key][measure, view] for key in keys]
            before = areas[VANILLA, None][measure, view]
            if any(area.value is None for area in (*own, before)):
                continue
            row: dict[str, Any] = {"model": model, "seed": seed, "scene_set": "natural", "metric": f"{measure} {view}"}
            row |= {"number": before.number} | _mean_area("", own, None)
            rows.append(row | (_mean_area("gain", own, before) if model != VANILLA else {}))
    return rows


def _mean_area(
    name: str, areas: Sequence[AveragePrecisionDraws], before: AveragePrecisionDraws | None
) -> dict[str, float | None]:
    """Return the mean of areas, minus `before` if given, and its interval over resampled scenes."""
    values = [float(area.value or 0.0) for area in areas]
    value = sum(values) / len(values) - float((before.value if before else 0.0) or 0.0)
    drawn = np.mean([_known(area) for area in areas], axis=0) - (_known(before) if before else 0.0)
    return _columns(name, value, *interval(drawn[np.isfinite(drawn)]))


def _columns(name: str, value: float, low: float | None, high: float | None) -> dict[str, float | None]:
    """Return the columns of a value and its interval. name: "gain", or "" for the value itself."""
    prefix = f"{name}_" if name else ""
    return {name or "value": value, f"{prefix}low": low, f"{prefix}high": high}


def _known(area: AveragePrecisionDraws) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in area.drawn], dtype=np.float64)
