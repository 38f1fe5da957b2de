"""Pareto front of settings: one combined error per setting, and the settings that no other setting dominates."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MISPLACED_M = 1.0
"""Error in metres that counts for a missed hit, a hit on a wrong surface, or a false hit.

Our choice. With this value the limits that `standard` promises weigh the same: 0.01 % misplaced hits give 0.1 mm, and
depth errors with a 99th percentile of 0.1 mm and a maximum of 1 mm give at most 0.11 mm. It is also the order of
magnitude of the real error: a misplaced return is elsewhere on the vehicle, or on an object behind it.
"""
ZERO_BELOW = 30.0
"""Factor between the smallest nonzero error and the position of zero on a logarithmic axis."""

_READ = (
    *("setting", "start", "ms_median", "missed_hits", "wrong_surface", "false_hits"),
    *("depth_p50_m", "depth_p99_m", "depth_max_m", "grid", "gradient"),
)


def misplaced_share(columns: Mapping[str, Any]) -> FloatArray:
    """Compute the share (N,) of true hits that are missed or on a wrong surface. columns: columns of the frontier."""
    return _floats(columns["missed_hits"]) + _floats(columns["wrong_surface"])


def effective_error_m(columns: Mapping[str, Any]) -> FloatArray:
    """Combine all errors of each row to one (N,) in metres: an upper bound of a beam's mean depth error, float64.

    ``0.5 p50 + 0.49 p99 + 0.01 max + MISPLACED_M * (missed + wrong surface + false hits)``

    The first three terms bound the mean of |depth error| by its median, 99th percentile and maximum: half of the hits
    are within the median, another 49 % within the percentile, the last 1 % within the maximum. Neither a good median
    nor a good percentile hides an outlier, unlike a ranking by one column.

    columns: depth_p50_m, depth_p99_m, depth_max_m and the fractions missed_hits, wrong_surface, false_hits, (N,) each,
    as in the frontier's table.
    """
    depth = 0.5 * _floats(columns["depth_p50_m"]) + 0.49 * _floats(columns["depth_p99_m"])
    depth = depth + 0.01 * _floats(columns["depth_max_m"])
    return np.asarray(depth + MISPLACED_M * (misplaced_share(columns) + _floats(columns["false_hits"])))


def warm_starts(columns: Mapping[str, Any]) -> BoolArray:
    """Return the mask (N,) of settings that start from a previous rendering: by the column `start`, or, if that is
    null as in a frontier of version 1, by the word "warm" in the setting's name. columns: columns of the frontier."""
    named = [re.search(r"\bwarm\b", setting) is not None for setting in columns["setting"]]
    known = columns.get("start", [None] * len(named))
    found = [start == "warm" if isinstance(start, str) else by_name for start, by_name in zip(known, named)]
    return np.array(found, dtype=bool)


def dominating_rows(
    time: npt.ArrayLike,
    error: npt.ArrayLike,
    warm: npt.ArrayLike | None = None,
    grid: npt.ArrayLike | None = None,
    gradient: Sequence[str] | None = None,
) -> npt.NDArray[np.int64]:
    """Find for each row the number of the row that dominates it, (N,) int64; -1 for rows on the Pareto front.

    Row A dominates row B if A takes no more time, has no larger error, and is better in at least one of the two. Rows
    equal in both do not dominate each other, so both can be on the front. Of several dominating rows the result is the
    fastest, then the most accurate, then the first; that row is itself on the front.

    Args:
        time, error: (N,), finite, in any unit; smaller is better.
        warm: (N,) bool, True for rows that need a previous rendering. A warm row cannot replace a cold row, so it
            dominates warm rows only; a cold row can dominate any row. None: all rows are cold.
        grid: (N,) bool, likewise for rows that need an SDF grid of the shape.
        gradient: (N,) variable that a row prepares the gradient for; "no": none. Only rows with the same variable can
            dominate a row with a variable. None: all "no".

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


def dominating_rows_of_table(columns: Mapping[str, Any]) -> npt.NDArray[np.int64]:
    """Apply `dominating_rows` to rows of one scene set. columns: columns (N,) of the frontier.

    Null in `grid` and `gradient`, as in a frontier of version 1, counts as no grid and no gradient.
    """
    grid = [each is True or each is np.True_ for each in columns["grid"]]
    gradient = [each if isinstance(each, str) else "no" for each in columns["gradient"]]
    warm = warm_starts(columns)
    return dominating_rows(columns["ms_median"], effective_error_m(columns), warm, grid, gradient)


def pareto_flags(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Compute the frontier's column `pareto`: True for rows that no other row of the same scene set dominates.

    rows: with setting, scenes, ms_median and the columns of ``effective_error_m``; start, grid, gradient are optional.
    """
    flags = np.zeros(len(rows), dtype=bool)
    for scenes in {row["scenes"] for row in rows}:
        members = [number for number, row in enumerate(rows) if row["scenes"] == scenes]
        columns = {name: [rows[number].get(name) for number in members] for name in _READ}
        flags[members] = dominating_rows_of_table(columns) < 0
    return flags.tolist()


def log_axis_errors(error: npt.ArrayLike, least: float) -> FloatArray:
    """Replace zeros in errors (N,) for a logarithmic axis: zero goes 1.5 decades below the smallest nonzero error.

    least: stands for the smallest nonzero error if all errors are zero.
    """
    errors = _floats(error)
    positive = errors[errors > 0]
    smallest = float(positive.min()) if len(positive) else least
    return np.where(errors > 0, errors, smallest / ZERO_BELOW)


def knee(time: npt.ArrayLike, error: npt.ArrayLike) -> int | None:
    """Find the knee of a front: the point farthest below the line between the front's ends, both axes logarithmic.

    Faster points lose much accuracy; slower points cost much time for little accuracy. The front's ends are scaled to
    distance one on either axis, so that units do not matter. ``log_axis_errors`` places errors of zero.

    time, error: (N,) of a front, in any order; times are positive. Returns the point's number, the fastest of equally
    far points; None with fewer than three points, equal ends, or no point below the line.
    """
    times, errors = _floats(time), log_axis_errors(error, 1.0)
    order = np.argsort(times, kind="stable")
    if len(order) < 3:
        return None
    x, y = np.log(times[order]), np.log(errors[order])
    if x[-1] <= x[0] or y[0] <= y[-1]:
        return None
    below = 1.0 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    # Rounded, so that rounding errors do not decide between equally far points.
    best = int(np.argmax(np.round(below, 12)))
    return int(order[best]) if below[best] > 1e-9 else None


def _floats(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
