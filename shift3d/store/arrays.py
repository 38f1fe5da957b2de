"""Arrays in files that are there whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shift3d.store.atomic import write_atomic


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays by name as .npz, in one step. Raises InputError: the disk is full or not writable."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, **arrays)

    write_atomic(path, write)
