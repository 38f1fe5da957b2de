"""Checks of error messages about unusable files, and a file that must not be unpickled."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from shift3d.errors import InputError


def refused(load: Callable[[], object], *words: str) -> None:
    """Check that loading raises a one-line InputError with a remedy and these words (the file, the place in it)."""
    try:
        load()
    except InputError as error:
        text = str(error)
        assert error.remedy and text.isprintable(), text
        assert all(word in text for word in words), f"{words} not in {text!r}"
        return
    raise AssertionError("taken as if nothing were wrong")


@contextmanager
def place() -> Iterator[Path]:
    """Yield an empty folder for this case alone."""
    with tempfile.TemporaryDirectory(prefix="hard-case-") as folder:
        yield Path(folder)


class Writes:
    """Object whose unpickling would write a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.write_text, (self._path, "code ran"))


def harmful(marker: Path) -> bytes:
    """Return a checkpoint whose unpickling writes `marker`."""
    return pickle.dumps({"epoch": 3, "model_state_dict": Writes(marker)})
