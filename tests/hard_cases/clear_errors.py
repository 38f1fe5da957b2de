"""What a person must be told about a file that cannot be used, and a file that must not be."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from shift3d.errors import InputError


def refused(load: Callable[[], object], *words: str) -> None:
    """Loading raises an InputError in one line with a remedy, and with these words (the file, the place in it)."""
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
    """An empty folder of this case alone."""
    with tempfile.TemporaryDirectory(prefix="hard-case-") as folder:
        yield Path(folder)


class Writes:
    """Unpickled, it would write a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.write_text, (self._path, "code ran"))


def harmful(marker: Path) -> bytes:
    """A checkpoint whose unpickling writes `marker`."""
    return pickle.dumps({"epoch": 3, "model_state_dict": Writes(marker)})
