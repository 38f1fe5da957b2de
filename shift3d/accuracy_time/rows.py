"""Rows of the frontier's table from the measured cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from shift3d.accuracy_time.measure import Outcome
from shift3d.accuracy_time.pareto import pareto_flags
from shift3d.accuracy_time.run import CaseResult
from shift3d.accuracy_time.settings import Setting

Row = dict[str, Any]


@dataclass(frozen=True)
class CaseResults:
    """Results of one case. scenes: scene set. beams: number of beams of the scene. results: by the setting's name.

    undecided: number of beams that the reference could not decide; the ground truth lacks them.
    """

    scenes: str
    beams: int
    results: Mapping[str, CaseResult]
    undecided: int = 0


def frontier_rows(settings: Sequence[Setting], cases: Sequence[CaseResults]) -> list[Row]:
    """Compute a row per scene set and setting for `store.frontier_table`, grouped by scene set.

    Counts and depths are pooled over the set's renderings. Times are the median and quartiles of each case's repeats,
    averaged over the cases: the spread is that of repeats, not of near and far vehicles. Ratios are null if the preset
    `paper`, or `paper` on the sphere's chord only, was not measured. Gradient columns hold the worst case.
    """
    rows: list[Row] = []
    for scenes in dict.fromkeys(case.scenes for case in cases):
        members = [case for case in cases if case.scenes == scenes]
        found = [_row(setting, scenes, members) for setting in settings]
        paper = next((row for row in found if row["preset"] == "paper"), None)
        chord = next((row for row, setting in zip(found, settings) if _is_chord_only(setting)), None)
        for row in found:
            row["ratio_to_paper"] = paper and paper["ms_median"] / row["ms_median"]
            row["ratio_to_paper_chord"] = chord and chord["ms_median"] / row["ms_median"]
            row["step_ratio_to_paper"] = paper and paper["step_ms_median"] / row["step_ms_median"]
        for row, flag in zip(found, pareto_flags(found)):
            row["pareto"] = flag
        rows += found
    return rows


def _is_chord_only(setting: Setting) -> bool:
    return setting.accuracy.get("solver") == "paper" and bool(setting.accuracy.get("sphere_chord_only"))


def _row(setting: Setting, scenes: str, cases: Sequence[CaseResults]) -> Row:
    results = [case.results[setting.name] for case in cases]
    looks = [result.look for result in results]
    outcomes = looks + [result.displaced for result in results if result.displaced is not None]
    attacked = [score for result in results if result.attack is not None for score in result.attack["scores"]]
    changes = [outcome["score"] - outcome["true_score"] for outcome in outcomes]
    times = np.array([np.percentile(result.samples_ms, (25, 50, 75)) for result in results]).mean(0)
    return {
        "setting": setting.name,
        "method": setting.method,
        "knob": setting.knob,
        "knob_name": setting.knob_name,
        "preset": setting.preset,
        "start": "cold" if setting.warm == "no" else "warm",
        "grid": setting.grid,
        "gradient": setting.variable,
        "scenes": scenes,
        "renders": len(outcomes),
        "beams": sum(case.beams for case in cases),
        "ms_median": float(times[1]),
        "ms_low": float(times[0]),
        "ms_high": float(times[2]),
        **_errors(outcomes),
        "gradient_cosine": min(value for look in looks for value in look["cosines"]),
        "gradient_norm_ratio": max((value for look in looks for value in look["norm_ratios"]), key=_off),
        "score_delta": fmean(map(abs, changes)),
        "auc_delta": fmean(changes),
        "detector_ms_median": fmean(_median(result.steps, "detector_ms") for result in results),
        "step_ms_median": fmean(_median(result.steps, "step_ms") for result in results),
        "attack_score": fmean(attacked) if attacked else None,
    }


def _errors(outcomes: Sequence[Outcome]) -> Row:
    """Compute error shares of true hits, and depth errors of hits on the right surface, over all renderings."""

    def total(name: str) -> int:
        return sum(outcome[name] for outcome in outcomes)

    depth = np.array([value for outcome in outcomes for value in outcome["depth_m"]] or [0.0])
    p50, p99 = np.percentile(depth, (50, 99))
    hits, thick = max(total("hits"), 1), max(total("thick_hits"), 1)
    return {
        "hits": total("hits"),
        "evaluations_per_beam": total("evaluations") / max(total("ball_beams"), 1),
        "missed_hits": total("missed") / hits,
        "missed_hits_2cm": total("missed_thick") / thick,
        "wrong_surface": total("wrong") / hits,
        "false_hits": total("false") / hits,
        "depth_p50_m": float(p50),
        "depth_p99_m": float(p99),
        "depth_max_m": float(depth.max()),
        "residual_max_m": max(outcome["residual_m"] for outcome in outcomes),
        "unresolved_beams": total("unresolved"),
    }


def _median(steps: Sequence[Outcome], name: str) -> float:
    return float(np.median([step[name] for step in steps]))


def _off(ratio: float) -> float:
    """Compute the distance of a ratio from 1: |log ratio|, infinite for zero."""
    return abs(math.log(ratio)) if ratio > 0 else math.inf
