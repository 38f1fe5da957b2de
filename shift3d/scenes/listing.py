"""Names of the scenes of a data set: choosing, and saying which there are."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.location import Location

UNITS_REMEDY = "Convert the file: coordinates and ranges are metres, angles radians"
_NEAREST_MEDIAN_M, _FARTHEST_MEDIAN_M, _FARTHEST_M = 0.5, 150.0, 1e4


def first_few(names: Collection[str]) -> str:
    """The first names in order, and how many there are."""
    ordered = sorted(names)
    return ", ".join(ordered[:5]) + (f", ... ({len(ordered)} in all)" if len(ordered) > 5 else "")


def names_in(folder: Location) -> list[str]:
    """Names of what lies in a folder; none where there is no folder."""
    try:
        return folder.names()
    except NotADirectoryError:
        return []


def chosen(found: Sequence[str], names: Sequence[str] | None, where: str) -> list[str]:
    """The names asked for, in the order asked; None: all that were found.

    Raises InputError: a name that was not found, or nothing at all.
    """
    known = set(found)
    for name in names or ():
        if name not in known:
            remedy = f"Choose from: {first_few(known)}" if known else "Check its name"
            raise InputError(f"no scene {name!r}", where, remedy)
    if not found:
        raise InputError("no scenes", where, "Give another folder")
    return list(found) if names is None else list(names)


def require_metres(ranges_m: NDArray[np.floating], where: str) -> None:
    """Refuse ranges (N,) > 0 that are no metres of a road scene: NaN, kilometres away, or the median below 0.5 m or
    beyond 150 m, as of centimetres, millimetres and kilometres.

    Raises InputError: naming the first row, or the median. Source: our choice of the bounds.
    """
    if not len(ranges_m):
        raise InputError("no point with a positive range", where, "Use another frame")
    bad = ~(np.abs(ranges_m) <= _FARTHEST_M)  # written so that NaN is bad
    if bad.any():
        row = int(bad.argmax())
        raise InputError(f"row {row} has a range of {ranges_m[row]:g} m", where, UNITS_REMEDY)
    median = float(np.median(ranges_m))
    if not _NEAREST_MEDIAN_M <= median <= _FARTHEST_MEDIAN_M:
        raise InputError(f"the median range is {median:g} m", where, UNITS_REMEDY)
