"""Helpers of the readers of recorded scenes: names, file access with clear errors, checks of arrays and units."""

from __future__ import annotations

import contextlib
import io
import tokenize
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.wording import counted

UNITS_REMEDY = "Convert the file: coordinates and ranges are metres, angles radians"
_AGAIN = "Copy it again"
_MISSING_REMEDY = "Add it, or leave the scene out"
_NEAREST_MEDIAN_M, _FARTHEST_MEDIAN_M = 0.5, 150.0
FARTHEST_M = 1e4
"""Largest distance of a return, label or sensor, and largest size; larger values mean a damaged file."""
TWO_TURNS_RAD = 4.0 * np.pi
"""Largest heading of a label: larger values are degrees, or a damaged file."""


def read_bytes(file: Location, kind: str, remedy: str = _MISSING_REMEDY) -> bytes:
    """Read a file. kind: name of the file's kind, for errors. remedy: advice if the file is missing.

    Raises InputError: it is missing, or cannot be read.
    """
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"the {kind} is missing", str(file), remedy) from error
    except OSError as error:
        raise InputError(f"the {kind} cannot be read ({error.strerror})", str(file), "Check the folder") from error


def read_lines(file: Location, kind: str, remedy: str = _MISSING_REMEDY) -> list[str]:
    """Read the lines of a text file. Args and Raises: as `read_bytes`; also InputError if the file is not text."""
    try:
        return read_bytes(file, kind, remedy).decode().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"the {kind} is no text", str(file), _AGAIN) from error


@contextlib.contextmanager
def opened(file: Location, kind: str, *bad: type[Exception]) -> Iterator[Any]:
    """Open a binary file. kind: name of the file's kind, for errors. bad: exceptions that mean damage, beside OSError
    and UnicodeDecodeError.

    Raises InputError: it is missing, cannot be read, or one of these exceptions is raised while it is open.
    """
    damaged: tuple[type[Exception], ...] = (OSError, UnicodeDecodeError, *bad)
    try:
        with contextlib.closing(file.open()) as handle:
            yield handle
    except FileNotFoundError as error:
        raise InputError(f"the {kind} is missing", str(file), _MISSING_REMEDY) from error
    except damaged as error:
        raise InputError(f"not a readable {kind} ({' '.join(str(error).split())[:120]})", str(file), _AGAIN) from error


def read_array(file: Location) -> NDArray[Any]:
    """Read the array of a .npy file. Raises InputError: it is missing, damaged, an archive, or not numeric."""
    content = read_bytes(file, ".npy file")
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (OSError, ValueError, EOFError, tokenize.TokenError) as error:  # NumPy parses the header as Python
        what = f"not a readable .npy file of numbers ({' '.join(str(error).split())[:80]})"
        raise InputError(what, str(file), _AGAIN) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        what = f"{getattr(array, 'dtype', 'an archive')}, not an array of numbers"
        raise InputError(what, str(file), "Give a float32 array")
    return array


def read_records(file: Location, kind: str, columns: int) -> NDArray[np.float32]:
    """Read rows (N, columns) of a file of little-endian float32, N at least 1.

    Raises InputError: as `read_bytes`; also if the file is empty or its last row is cut short.
    """
    raw, size = read_bytes(file, kind), 4 * columns
    if not raw or len(raw) % size:
        what = f"{counted(len(raw), 'byte')} is not a whole number of {size}-byte points"
        raise InputError(what, str(file), "Copy the file again: it is truncated.")
    return np.frombuffer(raw, dtype="<f4").reshape(-1, columns).astype(np.float32)


def refuse_not_finite(rows: NDArray[Any], where: str, remedy: str = "Repair or drop those rows") -> None:
    """Refuse rows (N, ...) with NaN or infinity. Raises InputError: naming their number and the first."""
    bad = ~np.isfinite(rows).all(axis=tuple(range(1, rows.ndim)))
    if bad.any():
        what = f"{counted(int(bad.sum()), 'row')} with NaN or infinity, first is row {int(bad.argmax())}"
        raise InputError(what, where, remedy)


def require_array(values: NDArray[Any], shape: tuple[int, ...], dtype: type[np.generic], where: str) -> None:
    """Refuse an array of another shape or type. Raises InputError: naming the required one."""
    if values.shape != shape:
        raise InputError(f"shape {values.shape}", where, f"Give {shape}")
    if values.dtype != dtype:
        raise InputError(f"dtype {values.dtype}", where, f"Cast it to {np.dtype(dtype).name}")


def abbreviated_list(names: Collection[str]) -> str:
    """Join the first names in order, and append the total number."""
    ordered = sorted(names)
    return ", ".join(ordered[:5]) + (f", ... ({len(ordered)} in all)" if len(ordered) > 5 else "")


def names_in(folder: Location) -> list[str]:
    """List the names in a folder; none if the folder does not exist."""
    try:
        return folder.names()
    except NotADirectoryError:
        return []


def stems_in(folder: Location, suffix: str) -> list[str]:
    """List names, without suffix, of a folder's files with this suffix, in order; none if there is no folder."""
    return [name.removesuffix(suffix) for name in names_in(folder) if name.endswith(suffix)]


def require_metres(ranges_m: NDArray[np.floating], where: str) -> None:
    """Refuse ranges (N,) that cannot be metres of a road scene: NaN, beyond 10 km, or a median below 0.5 m or beyond
    150 m, as from centimetres, millimetres or kilometres. A range of 0 is a beam without a return.

    Raises InputError: naming the first row, or the median. Source: our choice of the bounds.
    """
    if not (finite := np.isfinite(ranges_m)).all():
        raise InputError(f"row {int(finite.argmin())} is not finite", where, _AGAIN)
    if not ranges_m.any():
        raise InputError("no point with a positive range", where, "Use another frame")
    bad = ~(np.abs(ranges_m) <= FARTHEST_M)
    if bad.any():
        row = int(bad.argmax())
        raise InputError(f"row {row} has a range of {ranges_m[row]:g} m", where, UNITS_REMEDY)
    median = float(np.median(ranges_m[ranges_m > 0]))
    if not _NEAREST_MEDIAN_M <= median <= _FARTHEST_MEDIAN_M:
        raise InputError(f"the median range is {median:g} m", where, UNITS_REMEDY)
