"""What the objects share that a detector misses: a few short rules over measured quantities, by a shallow tree."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEPTH = 3
"""Most splits to a leaf: a rule of more conditions is read by nobody."""
LEAST_SHARE, LEAST_OBJECTS = 0.025, 8
"""A rule holds for so large a share of the objects, and for so many: a kind of the wide family has one in 34."""
LEAST_DROP = 0.05
"""A rule's mean score lies so far below that of the other objects, where it was found."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Condition:
    """low < quantity <= high; infinite where there is no such bound."""

    quantity: str
    low: float = -math.inf
    high: float = math.inf

    def holds(self, values: FloatArray) -> NDArray[np.bool_]:
        """Of values (N,)."""
        return np.asarray((values > self.low) & (values <= self.high))


@dataclass(frozen=True)
class FailureRule:
    """All of its conditions, at most one a quantity."""

    conditions: tuple[Condition, ...]

    def holds(self, quantities: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
        """Of N objects. quantities: (N,) by name."""
        return np.asarray(np.logical_and.reduce([one.holds(quantities[one.quantity]) for one in self.conditions]))


def find_rules(quantities: Mapping[str, FloatArray], scores: FloatArray, most: int = 5) -> list[FailureRule]:
    """A list of rules under which scores are low; none where nothing tells objects apart.

    A regression tree of at most three levels splits the objects. The leaf with the lowest mean is the first rule,
    where its mean lies at least 0.05 below that of all other objects. The next rule is found in the same way among the
    objects that no rule before it holds for: so a large effect does not hide a smaller one.

    Args: quantities: (N,) finite values by name. scores: (N,). most: rules to return.
    Source: CART (Breiman et al. 1984) by scikit-learn; separate and conquer (Fürnkranz 1999). Depth and least numbers
    are our choice.
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
    """The rule of one tree, over leaves of at least so many objects."""
    if len(scores) < 2 * least or not quantities:
        return None
    from sklearn.tree import DecisionTreeRegressor

    # What the smallest rule takes of the variance; a split that takes less makes none.
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
    """The conditions on the way to every leaf below a node of scikit-learn's tree."""
    left, right = tree.children_left[node], tree.children_right[node]  # type: ignore[attr-defined]
    if left == right:
        return [above]
    name, threshold = names[tree.feature[node]], float(tree.threshold[node])  # type: ignore[attr-defined]
    low, high = Condition(name, high=threshold), Condition(name, low=threshold)
    return _leaves(tree, names, left, (*above, low)) + _leaves(tree, names, right, (*above, high))


def _merged(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """One condition a quantity, in the order of their first."""
    merged: dict[str, Condition] = {}
    for one in conditions:
        other = merged.get(one.quantity, Condition(one.quantity))
        merged[one.quantity] = Condition(one.quantity, max(one.low, other.low), min(one.high, other.high))
    return tuple(merged.values())


def aspect_deg(x_m: FloatArray, y_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Angle between a vehicle's long axis and the line of sight to it, 0 (seen from an end) to 90 (from a side)."""
    along = np.cos(np.asarray(yaw_rad) - np.arctan2(y_m, x_m))
    return np.asarray(np.degrees(np.arccos(np.clip(np.abs(along), 0.0, 1.0))))
