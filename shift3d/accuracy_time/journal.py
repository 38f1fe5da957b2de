"""What has been measured on a case so far, on disk: an interrupted run goes on where it stopped."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from shift3d.store.atomic import write_atomic


class Journal:
    """Named values, one JSON line each, appended as they are measured.

    A line that a kill left torn is dropped when the journal is opened; it is what was being written, so it is
    measured again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._values: dict[str, Any] = {}
        lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
        whole = [line for line in lines if line.endswith(b"\n")]
        for line in whole:
            name, value = json.loads(line)
            self._values[name] = value
        if len(whole) != len(lines):
            write_atomic(path, b"".join(whole))

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def put(self, name: str, value: Any) -> None:
        """Keep a value of plain numbers, texts, lists and dictionaries."""
        line = json.dumps([name, value], allow_nan=False) + "\n"
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("ab") as file:
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())
        # As it would be read back: a run that is taken up again must not differ from one that was not.
        self._values[name] = json.loads(line)[1]

    def forget(self) -> None:
        """Everything."""
        self._path.unlink(missing_ok=True)
        self._values.clear()
