"""Choice of lambda and alpha by the paper's rules, from a sweep's own scores, with the reasons.

Source: SHIFT3D section Hyper-parameters and its supplement. alpha: the lowest AUC of the search's results. lambda: for
each vehicle the lowest adversarial loss, and 'in cases where different settings of λ produce very similar loss values,
we will choose the larger λ'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

NEARLY_EQUAL = 0.05
"""Share above the lowest loss up to which a loss is 'very similar'. Our choice: the paper gives no number."""
RULE_KEYS = ("vehicle", "mode", "alpha", "detector", "accuracy", "search", "effects")
"""Columns that distinguish the choices of lambda. alpha is chosen for all vehicles together."""
_ALPHA_KEYS = ("mode", "detector", "accuracy", "search", "effects")
_SCENE = ["dataset", "scene"]


def select_lambda(mean_loss: Mapping[float, float]) -> float:
    """Return the lambda with the lowest mean adversarial loss, or the largest one whose loss is nearly equal to it.

    Args: mean_loss: lambda to the mean of L_adv over the scenes that were scored under every lambda.
    Raises: ValueError: mean_loss is empty.
    """
    if not mean_loss:
        raise ValueError("no lambda to choose from")
    limit = min(mean_loss.values()) * (1.0 + NEARLY_EQUAL)
    return max(value for value, loss in mean_loss.items() if loss <= limit)


@dataclass(frozen=True)
class Choice:
    """One value chosen from candidates.

    found: candidate to its mean adversarial loss (lambda) or AUC (alpha). tasks: number behind each candidate: scenes
    (lambda) or vehicles in scenes (alpha), regardless of the number of places of a vehicle in a scene.
    """

    found: Mapping[float, float]
    chosen: float
    tasks: int


def choose_lambdas(scored: pd.DataFrame) -> dict[tuple[Any, ...], Choice]:
    """Choose lambda for every vehicle, by `RULE_KEYS`, from the scenes that were scored under every lambda.

    scored: rows with a score, `effects` as requested. Only the attacked detector's loss is used, since lambda belongs
    to the search. There is no choice without a scene that was scored under every lambda.
    """
    rows = _found(scored)
    rows = rows[(rows["mode"] != "pose") & rows["adversarial_loss"].notna()]
    chosen = {}
    for key, members in rows.groupby(list(RULE_KEYS), sort=False):
        losses = members.pivot_table(index=_SCENE, columns="lambda", values="adversarial_loss", aggfunc="mean")
        common = losses.dropna()
        if common.empty:
            continue
        means = {float(weight): float(loss) for weight, loss in common.mean().items()}
        chosen[tuple(key)] = Choice(means, select_lambda(means), len(common))
    return chosen


def choose_alphas(scored: pd.DataFrame) -> dict[tuple[Any, ...], Choice]:
    """Choose alpha for shape and for pose, by (mode, detector, accuracy, search, effects).

    The AUC is the mean over vehicles, each with its chosen lambda under that alpha, over the scenes that were scored
    under every alpha; without such a scene there is no choice. Of equal AUCs the smaller alpha is chosen.
    """
    rows = _found(scored)
    rows = rows[rows["search"].str.startswith("descent")]  # only descent has step sizes of alpha
    lambdas = {key: choice.chosen for key, choice in choose_lambdas(scored).items()}
    if rows.empty:
        return {}
    keys = rows[list(RULE_KEYS)].itertuples(index=False, name=None)
    kept = [lambdas.get(key, weight) == weight or key[1] == "pose" for key, weight in zip(keys, rows["lambda"])]
    chosen = {}
    for key, members in rows[kept].groupby(list(_ALPHA_KEYS), sort=False):
        scores = members.pivot_table(index=["vehicle", *_SCENE], columns="alpha", values="score", aggfunc="mean")
        common = scores.dropna()
        if common.empty:
            continue
        means = {float(alpha): float(auc) for alpha, auc in common.groupby(level="vehicle").mean().mean().items()}
        best = min(means, key=lambda alpha: (means[alpha], alpha))
        chosen[tuple(key)] = Choice(means, best, len(common))
    return chosen


def choice_rows(scored: pd.DataFrame, sweep: str, steps: set[int]) -> list[dict[str, Any]]:
    """Return the rows of ``choices``: all candidates of every choice, and why one was chosen."""
    rows: list[dict[str, Any]] = []
    known = {"sweep": sweep}
    alphas, lambdas = choose_alphas(scored), choose_lambdas(scored)
    for key, choice in alphas.items():
        named = dict(zip(_ALPHA_KEYS, key))
        of = ", ".join([f"the {named['mode']}", *_distinguished(named, _ALPHA_KEYS, alphas, ("mode",))])
        rows += _candidates(known | named | {"parameter": "alpha"}, choice, _why_alpha(of, choice, steps))
    for key, choice in lambdas.items():
        named = dict(zip(RULE_KEYS, key))
        of = f"the {str(named['vehicle']).replace('_', ' ')} at alpha {named['alpha']:g}"
        of = ", ".join([of, *_distinguished(named, RULE_KEYS, lambdas, ("vehicle", "alpha"))])
        rows += _candidates(known | named | {"parameter": "lambda"}, choice, _why_lambda(of, choice))
    return rows


def _distinguished(
    named: Mapping[str, Any], keys: Sequence[str], chosen: Mapping[tuple[Any, ...], Choice], known: Sequence[str]
) -> list[str]:
    """Return the keys, apart from known ones, in which a sweep's choices differ, with their values."""
    differ = [name for at, name in enumerate(keys) if name not in known and len({key[at] for key in chosen}) > 1]
    return [f"{name} {named[name]}" for name in differ]


def _found(scored: pd.DataFrame) -> pd.DataFrame:
    return scored[(scored["method"] == "adversarial") & (scored["scored_by"] == scored["detector"])]


def _candidates(known: dict[str, Any], choice: Choice, why: str) -> list[dict[str, Any]]:
    if len(choice.found) < 2:
        return []
    return [
        known
        | {"candidate": value, "found": found, "tasks": choice.tasks, "chosen": value == choice.chosen, "why": why}
        for value, found in sorted(choice.found.items())
    ]


def _why_alpha(of: str, choice: Choice, steps: set[int]) -> str:
    best, others = choice.chosen, sorted((auc, alpha) for alpha, auc in choice.found.items() if alpha != choice.chosen)
    text = f"alpha {best:g} for {of}: the AUC of what was found is the lowest, {choice.found[best]:.3f}"
    text += f" (next: {others[0][0]:.3f} at {others[0][1]:g})" if others else ""
    return f"{text}, in searches of {', '.join(str(count) for count in sorted(steps))} steps."


def _why_lambda(of: str, choice: Choice) -> str:
    found, best = choice.found, choice.chosen
    lowest = min(found, key=lambda value: (found[value], -value))
    of = f"lambda {best:g} for {of}"
    if best != lowest:
        near = f"is within {NEARLY_EQUAL:.0%} of the lowest, {found[lowest]:.3f} at {lowest:g}, and lambda is larger"
        return f"{of}: its mean adversarial loss, {found[best]:.3f}, {near}."
    larger = any(value > best for value in found)
    beyond = f", and no larger lambda comes within {NEARLY_EQUAL:.0%} of it" if larger else ""
    return f"{of}: its mean adversarial loss, {found[best]:.3f}, is the lowest{beyond}."
