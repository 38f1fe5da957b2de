"""Journal of a case's measurements on disk, so that an interrupted run resumes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from shift3d.store.atomic import write_atomic


class Journal:
    """Append-only file of named values, one JSON line per measurement.

    Opening the journal drops a last line that a kill left incomplete; the run measures its value again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
        whole = [line for line in lines if line.endswith(b"\n")]
        self._values: dict[str, Any] = dict(map(json.loads, whole))
        if len(whole) != len(lines):
            write_atomic(path, b"".join(whole))

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def put(self, name: str, value: Any) -> None:
        """Append a value of plain numbers, texts, lists and dictionaries, synchronized to disk."""
        line = json.dumps([name, value], allow_nan=False) + "\n"
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("ab") as file:
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())
        # The parsed line, so that a resumed run equals an uninterrupted one.
        self._values[name] = json.loads(line)[1]
