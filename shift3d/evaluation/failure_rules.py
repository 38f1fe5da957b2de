"""What the objects share that a detector misses: a few short rules over measured quantities, by a shallow tree."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEPTH = 3
"""Most splits to a leaf: a rule of more conditions is read by nobody."""
LEAST_SHARE, LEAST_OBJECTS = 0.05, 8
"""A rule holds for so large a share of the objects, and for so many."""
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
    """Rules under which scores are low, the lowest first; none where nothing tells objects apart.

    A regression tree of at most three levels splits the objects; the leaves whose mean lies at least 0.05 below that
    of all other objects are the rules.

    Args: quantities: (N,) finite values by name. scores: (N,). most: rules to return.
    Source: CART (Breiman et al. 1984) by scikit-learn; depth and least numbers are our choice.
    """
    least = max(LEAST_OBJECTS, math.ceil(LEAST_SHARE * len(scores)))
    if len(scores) < 2 * least or not quantities:
        return []
    from sklearn.tree import DecisionTreeRegressor

    names = list(quantities)
    table = np.column_stack([np.asarray(quantities[name], np.float64) for name in names])
    # What the smallest rule takes of the variance; a split that takes less makes none.
    least_decrease = LEAST_SHARE * (1 - LEAST_SHARE) * LEAST_DROP**2
    model = DecisionTreeRegressor(
        max_depth=DEPTH, min_samples_leaf=least, min_impurity_decrease=least_decrease, random_state=0
    )
    tree = model.fit(table, scores).tree_
    found = []
    for conditions in _leaves(tree, names, 0, ()):
        rule = FailureRule(_merged(conditions))
        inside = rule.holds({name: table[:, index] for index, name in enumerate(names)})
        if conditions and scores[inside].mean() <= scores[~inside].mean() - LEAST_DROP:
            found.append((float(scores[inside].mean()), rule))
    return [rule for _, rule in sorted(found, key=lambda pair: pair[0])[:most]]


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
