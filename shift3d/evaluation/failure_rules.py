"""Failure rules: a few short conditions on measured quantities that describe missed objects, from shallow trees."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEPTH = 3
"""Largest depth of a tree, so number of splits per rule: longer rules are hard to read."""
LEAST_SHARE, LEAST_OBJECTS = 0.025, 8
"""Least share and least number of objects that a rule covers: a kind of the wide family has one object in 34."""
LEAST_DROP = 0.05
"""Least difference between the mean score of a rule's objects and that of the other objects left in the search."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Condition:
    """Condition low < quantity <= high; infinite without a bound."""

    quantity: str
    low: float = -math.inf
    high: float = math.inf

    def holds(self, values: FloatArray) -> NDArray[np.bool_]:
        """True per value of (N,) if it satisfies the condition."""
        return np.asarray((values > self.low) & (values <= self.high))


@dataclass(frozen=True)
class FailureRule:
    """Conjunction of conditions, at most one per quantity."""

    conditions: tuple[Condition, ...]

    def holds(self, quantities: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
        """True per object, (N,), if all conditions hold. quantities: (N,) by name."""
        return np.asarray(np.logical_and.reduce([one.holds(quantities[one.quantity]) for one in self.conditions]))


def find_rules(quantities: Mapping[str, FloatArray], scores: FloatArray, most: int = 5) -> list[FailureRule]:
    """Find rules whose objects have low scores; an empty list if no quantity separates the objects.

    A regression tree of at most three levels splits the objects. The leaf with the lowest mean becomes the first rule
    if its mean is at least 0.05 below that of all other objects. The search repeats among the objects that no earlier
    rule covers, so that a large effect does not hide a smaller one.

    Args: quantities: (N,) finite values by name. scores: (N,). most: largest number of rules.
    Source: CART (Breiman et al. 1984) by scikit-learn; separate and conquer (Fürnkranz 1999); limits are our choice.
    """
    least = max(LEAST_OBJECTS, math.ceil(LEAST_SHARE * len(scores)))
    values = {name: np.asarray(column, np.float64) for name, column in quantities.items()}
    rest = np.ones(len(scores), dtype=bool)
    found: list[FailureRule] = []
    while len(found) < most:
        rule = _lowest_leaf({name: column[rest] for name, column in values.items()}, scores[rest], least)
        if rule is None:
            break
        found.append(rule)
        rest &= ~rule.holds(values)
    return found


def _lowest_leaf(quantities: Mapping[str, FloatArray], scores: FloatArray, least: int) -> FailureRule | None:
    """Fit one tree with at least `least` objects per leaf; return the rule of its lowest leaf, or None."""
    if len(scores) < 2 * least or not quantities:
        return None
    from sklearn.tree import DecisionTreeRegressor

    # Variance reduction of the smallest admissible rule; a split with a smaller reduction cannot make a rule.
    least_decrease = LEAST_SHARE * (1 - LEAST_SHARE) * LEAST_DROP**2
    model = DecisionTreeRegressor(
        max_depth=DEPTH, min_samples_leaf=least, min_impurity_decrease=least_decrease, random_state=0
    )
    tree = model.fit(np.column_stack(list(quantities.values())), scores).tree_
    rules = [FailureRule(_merged(conditions)) for conditions in _leaves(tree, list(quantities), 0, ()) if conditions]
    means = [scores[rule.holds(quantities)].mean() for rule in rules]
    if not rules:
        return None
    lowest = rules[int(np.argmin(means))]
    return lowest if min(means) <= scores[~lowest.holds(quantities)].mean() - LEAST_DROP else None


def _leaves(tree: object, names: Sequence[str], node: int, above: tuple[Condition, ...]) -> list[tuple[Condition, ...]]:
    """Return the conditions on the path to every leaf below a node of scikit-learn's tree."""
    left, right = tree.children_left[node], tree.children_right[node]  # type: ignore[attr-defined]
    if left == right:
        return [above]
    name, threshold = names[tree.feature[node]], float(tree.threshold[node])  # type: ignore[attr-defined]
    low, high = Condition(name, high=threshold), Condition(name, low=threshold)
    return _leaves(tree, names, left, (*above, low)) + _leaves(tree, names, right, (*above, high))


def _merged(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Merge conditions to one per quantity, in the order of first occurrence."""
    merged: dict[str, Condition] = {}
    for one in conditions:
        other = merged.get(one.quantity, Condition(one.quantity))
        merged[one.quantity] = Condition(one.quantity, max(one.low, other.low), min(one.high, other.high))
    return tuple(merged.values())


def aspect_deg(x_m: FloatArray, y_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Compute the angle between a vehicle's long axis and the line of sight: 0 (from an end) to 90 (from a side)."""
    along = np.cos(np.asarray(yaw_rad) - np.arctan2(y_m, x_m))
    return np.asarray(np.degrees(np.arccos(np.clip(np.abs(along), 0.0, 1.0))))
