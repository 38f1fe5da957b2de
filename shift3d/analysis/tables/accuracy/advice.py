"""Frontier in words: cost of each preset, cost of its neighbours, and dominated settings."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from shift3d.accuracy_time.pareto import (
    MISPLACED_M,
    dominating_rows_of_table,
    effective_error_m,
    knee,
    misplaced_share,
    warm_starts,
)
from shift3d.analysis.tables.table import factor, length, milliseconds, share
from shift3d.wording import counted

_LADDER = ("draft", "standard", "reference")  # fastest to most accurate; they replace `paper`
_DEFAULT = "standard"


def advice(frame: pd.DataFrame) -> str:
    """Generate one paragraph per scene set from the numbers; the same frame gives the same text.

    It states cost and errors of the presets, the gain of the default over the published algorithm, the cost of the next
    preset up or down, the knee of the front, and each dominated setting with its dominator.

    Args: frame: the frontier's table.
    """
    paragraphs = []
    for scenes in dict.fromkeys(frame["scenes"]):
        rows = frame[frame["scenes"] == scenes].reset_index(drop=True)
        rows["error_m"], rows["misplaced"] = effective_error_m(rows), misplaced_share(rows)
        rows["warm"] = warm_starts(rows)
        presets = {row["preset"]: row for _, row in rows[rows["preset"].notna()].iterrows()}
        sentences = [_costs(rows, str(scenes), presets)]
        if (default := presets.get(_DEFAULT)) is not None:
            sentences += [_against_paper(default, presets), _accuracy(default), *_steps(default, presets)]
            sentences += [_warm(rows, default), _loop(default)]
        sentences += [_attacks(rows), _knee(rows), *_dominated(rows)]
        paragraphs.append(" ".join(sentence for sentence in sentences if sentence))
    return "\n\n".join(paragraphs)


def _costs(rows: pd.DataFrame, scenes: str, presets: dict[str, Any]) -> str:
    first = f"On the {scenes} scenes ({counted(rows['renders'].max(), 'rendering')}, {rows['hits'].max():,} hits)"
    if not presets:
        fastest = rows.loc[rows["ms_median"].idxmin()]
        took = milliseconds(fastest["ms_median"])
        return f"{first} no preset was measured; the fastest setting, {fastest['setting']}, takes {took} a rendering."
    ordered = sorted(presets.values(), key=lambda row: float(row["ms_median"]))
    costs = [f"{row['preset']} takes {milliseconds(row['ms_median'])}" for row in ordered[:1]]
    costs += [f"{row['preset']} {milliseconds(row['ms_median'])}" for row in ordered[1:]]
    behind = [str(row["preset"]) for row in ordered if not row["pareto"] and row["preset"] != "paper"]
    on_front = f" {_and(behind)} {'is' if len(behind) == 1 else 'are'} not on the Pareto front." if behind else ""
    return f"{first} {_and(costs)} a rendering.{on_front}"


def _against_paper(default: pd.Series, presets: dict[str, Any]) -> str:
    if "paper" not in presets:
        return ""
    clipped = default["ratio_to_paper_chord"]
    chord = "" if np.isnan(clipped) else f" ({factor(clipped)} times as fast as paper on the sphere's chord only)"
    return (
        f"The default, {_DEFAULT}, is {factor(default['ratio_to_paper'])} times as fast as paper as published{chord}, "
        f"and misses or misplaces {_share(default['misplaced'])} of the hits; paper misses or misplaces "
        f"{_share(presets['paper']['misplaced'])}."
    )


def _accuracy(row: pd.Series) -> str:
    chords = f"it misses {_share(row['missed_hits_2cm'])} of the hits whose chord is 2 cm or longer"
    text = f"Its depth error is at most {length(row['depth_p50_m'])} for half of the hits, "
    text += f"{length(row['depth_p99_m'])} for 99 % and {length(row['depth_max_m'])} for all; {chords}"
    if not np.isnan(row["gradient_cosine"]):
        text += f"; the cosine between its gradient and reference's is {row['gradient_cosine']:.6g}"
    if not np.isnan(row["auc_delta"]):
        text += f", and the AUC changes by {row['auc_delta']:+.2g}"
    text += f". As one number that counts {length(MISPLACED_M)} for each misplaced beam, its error is at most "
    return f"{text}{length(row['error_m'])} per beam."


def _steps(here: pd.Series, presets: dict[str, Any]) -> list[str]:
    sentences = []
    for name in (name for name in _LADDER if name in presets and name != _DEFAULT):
        other = presets[name]
        down = _LADDER.index(name) < _LADDER.index(_DEFAULT)
        ratio = float(other["ms_median"] / here["ms_median"])
        takes = f"takes {factor(ratio)} times the time" if ratio > 1 else f"saves {share(1 - ratio)} of the time"
        error = f"an error of {length(other['error_m'])} instead of {length(here['error_m'])}"
        if other["misplaced"] or here["misplaced"]:
            error += f" and {_share(other['misplaced'])} of the hits misplaced instead of {_share(here['misplaced'])}"
        sentences.append(f"The {'faster' if down else 'more accurate'} preset, {name}, {takes}, with {error}.")
    return sentences


def _warm(rows: pd.DataFrame, default: pd.Series) -> str:
    """Describe the time that a start from the previous rendering saves with the default preset."""
    found = rows[rows["setting"] == f"{_DEFAULT}, warm"]
    if found.empty:
        return ""
    plain = rows[rows["setting"] == f"{_DEFAULT}, shape gradient"]
    warm, cold, how = found.iloc[0], default, "cold"
    if len(plain):  # an SDF grid fits one shape; a changing shape has none
        cold, how = plain.iloc[0], "cold with the gradient and without an SDF grid"
    text = f"Warm, starting from the previous rendering as in the attack loop, {_DEFAULT} takes "
    text += f"{milliseconds(warm['ms_median'])}: {factor(cold['ms_median'] / warm['ms_median'])} times as fast as {how}"
    if not np.isnan(warm["ratio_to_paper"]):
        text += f" and {factor(warm['ratio_to_paper'])} times as fast as paper as published"
    return text + "."


def _loop(row: pd.Series) -> str:
    if np.isnan(row["step_ms_median"]):
        return ""
    text = f"A whole attack step with {_DEFAULT} takes {milliseconds(row['step_ms_median'])}"
    if not np.isnan(row["step_ratio_to_paper"]):
        text += f", {factor(row['step_ratio_to_paper'])} times as fast as the published step"
    return text + "."


def _attacks(rows: pd.DataFrame) -> str:
    made = rows[rows["attack_score"].notna()]
    if made.empty:
        return ""
    parts = [f"{row['attack_score']:.3f} with {row['setting']}" for row in made.iloc]
    return f"Short attacks reach a mean score of {_and(parts)}."


def _knee(rows: pd.DataFrame) -> str:
    # Settings that render the same count once, as a preset if possible.
    front = rows[rows["pareto"] & ~rows["warm"]].sort_values("preset", kind="stable", na_position="last")
    front = (
        front.drop_duplicates(["ms_median", "error_m"]).sort_values("ms_median", kind="stable").reset_index(drop=True)
    )
    # A setting that needs more, such as a gradient, is on the front beside a faster and better one: no step along it.
    front = front[front["error_m"] < front["error_m"].cummin().shift(fill_value=np.inf)].reset_index(drop=True)
    at = knee(front["ms_median"], front["error_m"])
    if at is None:
        return ""
    row = front.iloc[at]
    text = f"The knee of the Pareto front is {row['setting']} "
    text += f"({milliseconds(row['ms_median'])}, error {length(row['error_m'])})"
    if at > 0:
        faster = front.iloc[at - 1]
        text += f": the next faster setting, {faster['setting']}, saves "
        text += f"{share(1 - faster['ms_median'] / row['ms_median'])} of the time at "
        error, least = faster["error_m"], row["error_m"]
        text += f"{factor(error / least)} times the error" if least else f"an error of {length(error)}"
    if at + 1 < len(front):
        better = front.iloc[at + 1]
        text += f"{';' if at > 0 else ':'} the next more accurate setting, {better['setting']}, takes "
        text += f"{factor(better['ms_median'] / row['ms_median'])} times the time at an error of "
        text += f"{length(better['error_m'])}"
    return text + "."


def _dominated(rows: pd.DataFrame) -> list[str]:
    """Describe which settings are dominated by which, starting with the setting that dominates most."""
    by = dominating_rows_of_table(rows)
    losers = np.flatnonzero(by >= 0)
    if not len(losers):
        return ["No setting is dominated."]
    winners, counts = np.unique(by[losers], return_counts=True)
    parts = [
        f"{rows['setting'].iloc[winner]} dominates {', '.join(_runs(rows, by, int(winner)))}"
        for winner in winners[np.argsort(-counts, kind="stable")]
    ]
    text = "Dominated settings, with their time relative to the fastest setting that is at least as accurate: "
    sentences = [text + "; ".join(parts) + "."]
    low, high, names = rows["ms_low"].to_numpy(), rows["ms_high"].to_numpy(), rows["setting"].to_numpy()
    close = [str(names[row]) for row in losers if high[by[row]] >= low[row]]
    if close:
        sentences.append(f"For {_and(close)} the quartiles of the two times overlap, so both may be equally fast.")
    return sentences


def _runs(rows: pd.DataFrame, by: npt.NDArray[np.int64], winner: int) -> list[str]:
    """List the settings that one setting dominates; three or more neighbours of one method as "first to last"."""
    ratio = rows["ms_median"].to_numpy() / rows["ms_median"].iloc[winner]
    names, parts = rows["setting"].to_numpy(), []
    # Neighbours are settings of one method in the order of its knob; methods are in the table's order.
    methods = list(dict.fromkeys(rows["method"]))
    order = np.lexsort((rows["knob"].to_numpy(dtype=np.float64), rows["method"].map(methods.index).to_numpy()))
    keys = [(rows["method"].iloc[row], by[row] == winner) for row in order]
    for (_, loses), group in itertools.groupby(zip(order, keys), key=lambda pair: pair[1]):
        run = [int(row) for row, _ in group]
        if loses and len(run) > 2 and rows["knob"].iloc[run].notna().all():
            spread = sorted(ratio[run])
            parts.append(f"{names[run[0]]} to {names[run[-1]]} ({factor(spread[0])} to {factor(spread[-1])} times)")
        elif loses:
            parts += [f"{names[row]} ({factor(ratio[row])} times)" for row in run]
    return parts


def _share(fraction: float) -> str:
    return share(fraction) if fraction else "none"


def _and(words: Iterable[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
