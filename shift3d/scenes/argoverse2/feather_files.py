"""Feather files, as Argoverse 2 has them: columns by name, whatever their width."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import from_quaternion
from shift3d.store.location import Location

__all__ = ["column", "feather_table", "poses"]

_AGAIN = "Copy it again"
_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


def feather_table(file: Location, columns: Sequence[str]) -> pa.Table:
    """The columns of a file; others are not read.

    Raises:
        InputError: the file is missing, no Feather file or cut short, lacks a column, or has no rows.
    """
    try:
        with contextlib.closing(file.open()) as handle:
            names = pa.ipc.open_file(handle).schema.names
            missing = [name for name in columns if name not in names]
            if missing:
                raise InputError(f"no column {missing[0]}", str(file), "Give the data set's own file")
            handle.seek(0)
            table = feather.read_table(handle, columns=list(columns), memory_map=False)
    except FileNotFoundError as error:
        raise InputError("the file is missing", str(file), "Copy it, or leave the scene out") from error
    except (pa.ArrowException, OSError) as error:
        what = f"not a readable Feather file ({' '.join(str(error).split())[:120]})"
        raise InputError(what, str(file), _AGAIN) from error
    if not table.num_rows:
        raise InputError("the table has no rows", str(file), f"{_AGAIN}, or leave it out")
    return table


def column(table: pa.Table, name: str, dtype: type[np.generic], file: Location) -> NDArray[np.generic]:
    """One column of numbers, (rows,), cast to a dtype. Raises InputError: it is no numbers, or has gaps."""
    found = table[name]
    number = pa.types.is_integer(found.type) or pa.types.is_floating(found.type)
    if found.null_count or not number:
        raise InputError(f"column {name} has gaps or is no numbers", str(file), _AGAIN)
    values: NDArray[np.generic] = found.to_numpy().astype(dtype)
    return values


def poses(table: pa.Table, file: Location) -> NDArray[np.float64]:
    """(rows, 4, 4) of the columns qw, qx, qy, qz, tx_m, ty_m, tz_m. Raises InputError: one is no pose."""
    numbers = np.stack([column(table, name, np.float64, file) for name in _POSE], axis=1).astype(np.float64)
    return from_quaternion(numbers[:, :4], numbers[:, 4:], str(file))
