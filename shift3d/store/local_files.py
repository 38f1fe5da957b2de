"""Locations in a folder of this machine's file systems."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar

from shift3d.store import atomic
from shift3d.store.location import Location

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class LocalLocation(Location):
    """A file or folder of this machine's file systems."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def name(self) -> str:
        """See `Location`."""
        return self.path.name

    def __truediv__(self, part: str) -> LocalLocation:
        return LocalLocation(self.path / part)

    def absolute(self) -> LocalLocation:
        """See `Location`."""
        return LocalLocation(self.path.resolve())

    def is_file(self) -> bool:
        """See `Location`."""
        return self.path.is_file()

    def size(self) -> int:
        """See `Location`."""
        return self.path.stat().st_size

    def read_bytes(self) -> bytes:
        """See `Location`."""
        return self.path.read_bytes()

    def open(self) -> BinaryIO:
        """See `Location`."""
        return self.path.open("rb")

    def version(self) -> str:
        """See `Location`: size and time of last change."""
        try:
            state = self.path.stat()
        except OSError:
            return ""
        return f"{state.st_size}-{state.st_ctime_ns}"

    def names(self) -> list[str]:
        """See `Location`."""
        if not self.path.is_dir() and not self.path.exists():
            return []
        return sorted(entry.name for entry in self.path.iterdir() if not entry.name.startswith("."))

    def write_atomic(self, content: bytes) -> None:
        """See `Location`."""
        atomic.write_atomic(self.path, content)

    def put_if_absent(self, content: bytes) -> bool:
        """See `Location`."""
        return atomic.put_if_absent(self.path, content)

    def delete(self) -> None:
        """See `Location`."""
        self.path.unlink(missing_ok=True)

    def leftovers(self) -> list[Location]:
        """See `Location`. Writers of other machines are left alone: nobody here knows whether they run."""
        return [LocalLocation(path) for path in atomic.leftovers(self.path)]

    def check_writable(self) -> None:
        """See `Location`: hard links have one winner on every file system that has them, so a folder is tried alone."""
        atomic.check_writable(self.path)

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See `Location`."""
        return [function(item) for item in items]
