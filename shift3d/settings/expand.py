"""Expansion of a sweep's axes to settings of tasks, in Hydra's multirun order, without Hydra."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from shift3d.errors import InputError
from shift3d.settings.compose import ComposedSweep, Values, validate
from shift3d.settings.schema.config import Config


def expand(composed: ComposedSweep) -> Iterator[Config]:
    """Yield checked settings of every combination. The last axis varies fastest, as in Hydra's BasicSweeper.

    Raises: InputError: the schema refuses a combination, or a setting of the runner or tracking is an axis.
    """
    where = f"sweep {composed.name}"
    for axis in composed.axes:
        if axis.key.split(".")[0] in ("runner", "tracking"):
            raise InputError(f"{axis.key} cannot be an axis: it changes no result", where, "Give it one value")
    if not composed.axes:
        yield validate(composed.base, where)
        return
    # As in Hydra, group options apply before single settings, whatever the order of the overrides.
    groups = [axis.key for axis in composed.axes if axis.is_group]
    order = sorted(range(len(composed.axes)), key=lambda i: not composed.axes[i].is_group)
    for combination in itertools.product(*(range(len(axis.values)) for axis in composed.axes)):
        values = dict(composed.base)
        for index in order:
            axis = composed.axes[index]
            _put(values, axis.key, axis.values[combination[index]])
        yield validate(values, where, groups)


def _put(values: Values, key: str, value: object) -> None:
    """Set a value in copies of its parent dictionaries: combinations share everything that no axis changes."""
    *parents, leaf = key.split(".")
    for parent in parents:
        inner = dict(values[parent])
        values[parent] = inner
        values = inner
    values[leaf] = value
