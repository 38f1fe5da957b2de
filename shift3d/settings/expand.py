"""Axes to tasks' settings, in plain Python, in the order of Hydra's own multirun."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from shift3d.errors import InputError
from shift3d.settings.compose import Composed, Values, validate
from shift3d.settings.schema.config import Config


def expand(composed: Composed) -> Iterator[Config]:
    """Checked settings of every combination; the last axis varies fastest, as in Hydra's BasicSweeper.

    Raises: InputError: a combination that the schema refuses, or settings of the runner or tracking as an axis.
    """
    where = f"sweep {composed.name}"
    for axis in composed.axes:
        if axis.key.split(".")[0] in ("runner", "tracking"):
            raise InputError(f"{axis.key} cannot be an axis: it changes no result", where, "Give it one value")
    if not composed.axes:
        yield validate(composed.base, where)
        return
    # Whole groups are put in place before single settings, whichever was named first, as Hydra does.
    groups = [axis.key for axis in composed.axes if axis.is_group]
    order = sorted(range(len(composed.axes)), key=lambda i: not composed.axes[i].is_group)
    for combination in itertools.product(*(range(len(axis.values)) for axis in composed.axes)):
        values = dict(composed.base)
        for index in order:
            axis = composed.axes[index]
            _put(values, axis.key, axis.values[combination[index]])
        yield validate(values, where, groups)


def _put(values: Values, key: str, value: object) -> None:
    """Set a value, in copies of what holds it: combinations share everything that no axis changes."""
    *parents, leaf = key.split(".")
    for parent in parents:
        inner = dict(values[parent])
        values[parent] = inner
        values = inner
    values[leaf] = value
