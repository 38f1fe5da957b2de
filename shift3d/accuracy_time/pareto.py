"""Which settings are worth their time: one error for every way of being wrong, and what no other setting beats."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MISPLACED_M = 1.0
"""Metres of error that a beam counts which missed, hit another surface, or hit where nothing is.

Our choice. It is the rate at which the limits that `standard` promises to keep weigh the same: 0.01 % of the hits
misplaced come to 0.1 mm, depths with a 99th percentile of 0.1 mm and a maximum of 1 mm to 0.11 mm at most. It is
also the order of magnitude of what happens: such a return lies elsewhere on the vehicle, or on what is behind it.
"""


ZERO_BELOW = 30.0
"""How many times below the smallest error that is not zero a logarithmic axis has its zero."""

_READ = (
    *("setting", "start", "ms_median", "missed_hits", "wrong_surface", "false_hits"),
    *("depth_p50_m", "depth_p99_m", "depth_max_m", "grid", "gradient"),
)


def misplaced(columns: Mapping[str, Any]) -> FloatArray:
    """Share of true hits (N,) that are missed or on a wrong surface. columns: the frontier's, or a frame of it."""
    return _floats(columns["missed_hits"]) + _floats(columns["wrong_surface"])


def effective_error_m(columns: Mapping[str, Any]) -> FloatArray:
    """One error (N,) in metres for every way of being wrong: a bound on the mean error of a beam's depth.

    ``0.5 p50 + 0.49 p99 + 0.01 max + MISPLACED_M * (missed + wrong surface + false hits)``, float64.

    The first three terms are the most that the mean of |depth error| can be, given its median, 99th percentile and
    maximum: half of the hits are within the median, 49 % more within the percentile, the last one within the maximum.
    Neither a good median nor a good percentile hides an outlier, unlike in an order that looks at one column first.

    Args: columns: depth_p50_m, depth_p99_m, depth_max_m and the fractions missed_hits, wrong_surface, false_hits, (N,)
    each, as in the frontier's table.
    """
    depth = 0.5 * _floats(columns["depth_p50_m"]) + 0.49 * _floats(columns["depth_p99_m"])
    depth = depth + 0.01 * _floats(columns["depth_max_m"])
    return np.asarray(depth + MISPLACED_M * (misplaced(columns) + _floats(columns["false_hits"])))


def warm_starts(columns: Mapping[str, Any]) -> BoolArray:
    """Which settings start from a previous rendering (N,): by their column `start`, and where it is null, as in a
    frontier of version 1, by the word "warm" in their names. columns: the frontier's, or a frame of it."""
    named = [re.search(r"\bwarm\b", setting) is not None for setting in columns["setting"]]
    known = columns.get("start", [None] * len(named))
    found = [start == "warm" if isinstance(start, str) else by_name for start, by_name in zip(known, named)]
    return np.array(found, dtype=bool)


def dominators(
    time: npt.ArrayLike,
    error: npt.ArrayLike,
    warm: npt.ArrayLike | None = None,
    grid: npt.ArrayLike | None = None,
    gradient: Sequence[str] | None = None,
) -> npt.NDArray[np.int64]:
    """For each row the row that makes it pointless, or -1 where it is on the front.

    A row is dominated by one that takes no more time and has no larger error, and is better in at least one of the
    two. So of rows that tie in both neither dominates the other, and both can be on the front.
    Of several that dominate a row, the fastest is named, of these the most accurate, and of these the first; it is
    itself on the front.

    Args:
        time, error: (N,), finite, in any unit; smaller is better.
        warm: (N,) bool, rows that need a previous rendering to start from. They cannot stand in for a row that needs
            none, so they dominate one another only; a row that needs none can dominate any. None: no row needs one.
        grid: (N,) bool, likewise rows that need an SDF grid of the shape.
        gradient: (N,) of what rows are ready to take the gradient, "no" for nothing. Only a row that is ready for the
            same can dominate one that is ready. None: no row is.

    Returns: (N,) int64 row numbers.

    Raises: ValueError: a time or an error is not finite, or the lengths differ.
    """
    times, errors = _floats(time), _floats(error)
    nothing = np.zeros(times.shape, dtype=bool)
    needs = [nothing if each is None else np.asarray(each, dtype=bool) for each in (warm, grid)]
    ready = np.asarray(["no"] * len(nothing) if gradient is None else list(gradient), dtype=str)
    shapes = {times.shape, errors.shape, ready.shape, *(each.shape for each in needs)}
    if times.ndim != 1 or len(shapes) != 1:
        raise ValueError(f"times {times.shape}, errors {errors.shape} and warm {needs[0].shape} must be (N,) each")
    if not (np.isfinite(times).all() and np.isfinite(errors).all()):
        raise ValueError("a time or an error is not finite")
    no_worse = (times[:, None] <= times) & (errors[:, None] <= errors)
    better = (times[:, None] < times) | (errors[:, None] < errors)
    beats = no_worse & better & ((ready[:, None] == ready) | (ready == "no"))
    for each in needs:
        beats &= ~each[:, None] | each
    found = np.full(len(times), -1, dtype=np.int64)
    best_first = np.lexsort((np.arange(len(times)), errors, times))
    for row in np.flatnonzero(beats.any(axis=0)):
        found[row] = next(other for other in best_first if beats[other, row])
    return found


def dominators_of(columns: Mapping[str, Any]) -> npt.NDArray[np.int64]:
    """`dominators` of rows of one scene set, whose columns (N,) are the frontier's, or a frame of it.

    Where `grid` and `gradient` are null, as in a frontier of version 1, nothing is known to need or to do more.
    """
    grid = [each is True or each is np.True_ for each in columns["grid"]]
    gradient = [each if isinstance(each, str) else "no" for each in columns["gradient"]]
    warm = warm_starts(columns)
    return dominators(columns["ms_median"], effective_error_m(columns), warm, grid, gradient)


def pareto_flags(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """The column `pareto` of the frontier: for each row whether no other of the same scenes dominates it.

    Args: rows: of the frontier, with setting, scenes, ms_median, perhaps grid and gradient, and what
    ``effective_error_m`` reads.
    """
    flags = np.zeros(len(rows), dtype=bool)
    for scenes in {row["scenes"] for row in rows}:
        members = [number for number, row in enumerate(rows) if row["scenes"] == scenes]
        columns = {name: [rows[number].get(name) for number in members] for name in _READ}
        flags[members] = dominators_of(columns) < 0
    return [bool(flag) for flag in flags]


def drawable(error: npt.ArrayLike, least: float) -> FloatArray:
    """Errors (N,) with a place on a logarithmic axis: zero goes a decade and a half below the smallest that is not.

    least: what stands for the smallest where all are zero.
    """
    errors = _floats(error)
    positive = errors[errors > 0]
    smallest = float(positive.min()) if len(positive) else least
    return np.where(errors > 0, errors, smallest / ZERO_BELOW)


def knee(time: npt.ArrayLike, error: npt.ArrayLike) -> int | None:
    """The point of a front farthest below the straight line between its ends, both axes logarithmic.

    Faster than there, accuracy is lost quickly; slower than there, it is bought dearly. Times and errors are scaled
    so that the front's ends are at distance one on either axis, so that the units do not matter. An error of zero is
    where the diagram draws it, see ``drawable``.

    Args: time, error: (N,) of a front, in any order; times positive.

    Returns: The point's number, the fastest where several are as far; None with fewer than three points that differ, or
    where none is below the line.
    """
    times, errors = _floats(time), drawable(error, 1.0)
    order = np.argsort(times, kind="stable")
    if len(order) < 3:
        return None
    x, y = np.log(times[order]), np.log(errors[order])
    if x[-1] <= x[0] or y[0] <= y[-1]:
        return None
    below = 1.0 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    # Rounded, so that points as far from the line as one another are so whatever the last digit says.
    best = int(np.argmax(np.round(below, 12)))
    return int(order[best]) if below[best] > 1e-9 else None


def _floats(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
