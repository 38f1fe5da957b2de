"""What readers of recorded scenes share: names, files read as bytes and text, and bounds of what is metres."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.wording import counted

UNITS_REMEDY = "Convert the file: coordinates and ranges are metres, angles radians"
_NEAREST_MEDIAN_M, _FARTHEST_MEDIAN_M, _FARTHEST_M = 0.5, 150.0, 1e4


_MISSING_REMEDY = "Add it, or leave the scene out"


def read_bytes(file: Location, kind: str, remedy: str = _MISSING_REMEDY) -> bytes:
    """A file's content. kind: what it is, for errors. remedy: what to do where there is none.

    Raises InputError: it is missing, or cannot be read.
    """
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"the {kind} is missing", str(file), remedy) from error
    except OSError as error:
        raise InputError(f"the {kind} cannot be read ({error.strerror})", str(file), "Check the folder") from error


def read_lines(file: Location, kind: str, remedy: str = _MISSING_REMEDY) -> list[str]:
    """Lines of a text file. Args and Raises: as `read_bytes`, and where it is no text."""
    try:
        return read_bytes(file, kind, remedy).decode().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"the {kind} is no text", str(file), "Copy it again") from error


def refuse_not_finite(rows: NDArray[Any], where: str, remedy: str = "Repair or drop those rows") -> None:
    """Refuse rows (N, ...) with NaN or infinity. Raises InputError: naming how many there are, and the first."""
    bad = ~np.isfinite(rows).all(axis=tuple(range(1, rows.ndim)))
    if bad.any():
        what = f"{counted(int(bad.sum()), 'row')} with NaN or infinity, first is row {int(bad.argmax())}"
        raise InputError(what, where, remedy)


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


def chosen(found: Iterable[str], names: Sequence[str] | None, where: str, count: int | None = None) -> list[str]:
    """The names asked for, in the order asked; None: the first `count` that are found, all of them without one.

    Raises InputError: a name that was not found, or nothing at all.
    """
    known = list(islice(found, count if names is None else None))
    for name in names or ():
        if name not in known:
            remedy = f"Choose from: {first_few(known)}" if known else "Check its name"
            raise InputError(f"no scene {name!r}", where, remedy)
    if not known:
        raise InputError("no scenes", where, "Give another folder")
    return known if names is None else list(names)


def require_metres(ranges_m: NDArray[np.floating], where: str) -> None:
    """Refuse ranges (N,) that are no metres of a road scene: NaN, kilometres away, or the median below 0.5 m or beyond
    150 m, as of centimetres, millimetres and kilometres. A range of 0 is a beam without a return.

    Raises InputError: naming the first row, or the median. Source: our choice of the bounds.
    """
    if not (finite := np.isfinite(ranges_m)).all():
        raise InputError(f"row {int(finite.argmin())} is not finite", where, "Copy it again")
    if not ranges_m.any():
        raise InputError("no point with a positive range", where, "Use another frame")
    bad = ~(np.abs(ranges_m) <= _FARTHEST_M)
    if bad.any():
        row = int(bad.argmax())
        raise InputError(f"row {row} has a range of {ranges_m[row]:g} m", where, UNITS_REMEDY)
    median = float(np.median(ranges_m[ranges_m > 0]))
    if not _NEAREST_MEDIAN_M <= median <= _FARTHEST_MEDIAN_M:
        raise InputError(f"the median range is {median:g} m", where, UNITS_REMEDY)
