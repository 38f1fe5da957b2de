"""Locations of a sweep's files: a folder on this machine's file systems, or a prefix in a bucket.

Both give the commit log two guarantees: a file is complete or absent, and exactly one of several writers creates a new
name. pyarrow's file systems are not used: their S3 has no put that fails if the file exists.

Source: our choice (design section 9).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from shift3d.store import atomic

Item = TypeVar("Item")
Result = TypeVar("Result")


class Location(ABC):
    """File or folder with a name; it need not exist. ``/`` returns a child, str() the path or URL.

    Locations of equal name are equal. A location can be sent to another process.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Last part of the path or key."""

    @abstractmethod
    def __truediv__(self, part: str) -> Location: ...

    @abstractmethod
    def absolute(self) -> Location:
        """Return the same location, valid in a process with another working directory."""

    @abstractmethod
    def is_file(self) -> bool:
        """True if the location is a file that exists."""

    @abstractmethod
    def size(self) -> int:
        """Return the size of the file in bytes. Raises FileNotFoundError if it is absent."""

    @abstractmethod
    def read_bytes(self) -> bytes:
        """Return the content of the file. Raises FileNotFoundError if it is absent."""

    def read_text(self) -> str:
        """Return the content as UTF-8. Raises FileNotFoundError if the file is absent, ValueError if it is no text."""
        return self.read_bytes().decode()

    @abstractmethod
    def open(self) -> Any:
        """Return a seekable binary file object, for partial reads. Raises FileNotFoundError if the file is absent."""

    @abstractmethod
    def version(self) -> str:
        """Return a text that changes whenever the content may change; empty if the file is absent."""

    @abstractmethod
    def names(self) -> list[str]:
        """Return the sorted names of the files and folders inside, without hidden ones; [] if the folder is absent.

        Raises: NotADirectoryError: the location is no folder.
        """

    @abstractmethod
    def write_atomic(self, content: bytes) -> None:
        """Write the file in one step: it has the old content or the new one.

        Raises: InputError: the file cannot be written; the message says what to do.
        """

    @abstractmethod
    def put_if_absent(self, content: bytes) -> bool:
        """Create the file in one step unless it exists. Return True if the file has the given content.

        The answer may get lost after the file was created; a second try then finds the file. Writers that compete for a
        name must therefore put their own name into the content.

        Raises: UncertainError: the file may or may not exist. InputError: the file was not created and cannot be.
        """

    @abstractmethod
    def delete(self) -> None:
        """Remove the file if it exists."""

    @abstractmethod
    def leftovers(self) -> list[Location]:
        """Return the half-written files in this folder whose writers are dead."""

    @abstractmethod
    def check_writable(self, word: str = "") -> None:
        """Check that `put_if_absent` has exactly one winner in this folder.

        word: see `atomic.check_writable`. Raises: InputError: several win, or no file is written.
        """

    @abstractmethod
    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Return ``function`` of each item, in order. Remote locations use several threads."""


@dataclass(frozen=True)
class LocalLocation(Location):
    """File or folder on this machine's file systems."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def name(self) -> str:
        return self.path.name

    def __truediv__(self, part: str) -> LocalLocation:
        return LocalLocation(self.path / part)

    def absolute(self) -> LocalLocation:
        return LocalLocation(self.path.resolve())

    def is_file(self) -> bool:
        return self.path.is_file()

    def size(self) -> int:
        return self.path.stat().st_size

    def read_bytes(self) -> bytes:
        return self.path.read_bytes()

    def open(self) -> BinaryIO:
        return self.path.open("rb")

    def version(self) -> str:
        """See `Location`: size and time of the last change."""
        try:
            state = self.path.stat()
        except OSError:
            return ""
        return f"{state.st_size}-{state.st_ctime_ns}"

    def names(self) -> list[str]:
        if not self.path.exists():
            return []
        return sorted(entry.name for entry in self.path.iterdir() if not entry.name.startswith("."))

    def write_atomic(self, content: bytes) -> None:
        atomic.write_atomic(self.path, content)

    def put_if_absent(self, content: bytes) -> bool:
        return atomic.put_if_absent(self.path, content)

    def delete(self) -> None:
        self.path.unlink(missing_ok=True)

    def leftovers(self) -> list[Location]:
        """See `Location`. Files of other machines stay: this machine cannot know if their writers run."""
        return [LocalLocation(path) for path in atomic.leftovers(self.path)]

    def check_writable(self, word: str = "") -> None:
        """See `Location`: hard links, where they exist, have one winner, so only the creation of a folder is tried."""
        atomic.check_writable(self.path, word)

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        return [function(item) for item in items]
