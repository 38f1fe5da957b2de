"""Where a sweep's files lie: a folder of this machine's file systems, or a prefix of a bucket.

Both give the commit log what it rests on: a file is there whole or not at all, and of several writers of one new name
exactly one succeeds. pyarrow's file systems are not used, since their S3 has no put that fails where a file is there.

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
    """A file or a folder by its name, whether it is there or not. ``/`` gives what lies in it; str() its path or URL.

    Two locations of the same name are equal. One can be sent to another process.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """The last part of it."""

    @abstractmethod
    def __truediv__(self, part: str) -> Location: ...

    @abstractmethod
    def absolute(self) -> Location:
        """The same, for a process with another working directory."""

    @abstractmethod
    def is_file(self) -> bool:
        """Whether a file is there."""

    @abstractmethod
    def size(self) -> int:
        """Bytes of a file. Raises FileNotFoundError where there is none."""

    @abstractmethod
    def read_bytes(self) -> bytes:
        """A file's content. Raises FileNotFoundError where there is none."""

    def read_text(self) -> str:
        """A file's content as UTF-8. Raises FileNotFoundError where there is none, ValueError where it is no text."""
        return self.read_bytes().decode()

    @abstractmethod
    def open(self) -> Any:
        """A file's content as a binary file object that reads from any place of it, for files read in part.

        Raises: FileNotFoundError: there is none.
        """

    @abstractmethod
    def version(self) -> str:
        """A text that changes whenever the file's content may; empty where there is no file."""

    @abstractmethod
    def names(self) -> list[str]:
        """Names of the files and folders in it, in order, without hidden ones; none where there is no such folder.

        Raises: NotADirectoryError: something else is there.
        """

    @abstractmethod
    def write_atomic(self, content: bytes) -> None:
        """Write a file: whole, or as it was before.

        Raises: InputError: it cannot be written; the message says what to do.
        """

    @abstractmethod
    def put_if_absent(self, content: bytes) -> bool:
        """Create a file in one step, unless there is one. True where its content is now the given one.

        An answer may get lost after the file was created: then a second try finds it there. So writers whose place
        among others matters must put their own name into the content.

        Raises: UncertainError: nobody can say whether it was created. InputError: it was not, and cannot be.
        """

    @abstractmethod
    def delete(self) -> None:
        """Remove a file where there is one."""

    @abstractmethod
    def leftovers(self) -> list[Location]:
        """Files in this folder that writers which no longer run left half-written."""

    @abstractmethod
    def check_writable(self, word: str = "out=DIR") -> None:
        """Make sure that `put_if_absent` has one winner here. word: what names another folder, for the message.

        Raises: InputError: it has not, or nothing can be written.
        """

    @abstractmethod
    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """``function`` of each of the items, in their order: by several threads where files are far away."""


@dataclass(frozen=True)
class LocalLocation(Location):
    """A file or folder of this machine's file systems."""

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
        """See `Location`: size and time of last change."""
        try:
            state = self.path.stat()
        except OSError:
            return ""
        return f"{state.st_size}-{state.st_ctime_ns}"

    def names(self) -> list[str]:
        if not self.path.is_dir() and not self.path.exists():
            return []
        return sorted(entry.name for entry in self.path.iterdir() if not entry.name.startswith("."))

    def write_atomic(self, content: bytes) -> None:
        atomic.write_atomic(self.path, content)

    def put_if_absent(self, content: bytes) -> bool:
        return atomic.put_if_absent(self.path, content)

    def delete(self) -> None:
        self.path.unlink(missing_ok=True)

    def leftovers(self) -> list[Location]:
        """See `Location`. Writers of other machines are left alone: nobody here knows whether they run."""
        return [LocalLocation(path) for path in atomic.leftovers(self.path)]

    def check_writable(self, word: str = "out=DIR") -> None:
        """See `Location`: hard links have one winner on every file system that has them, so a folder is tried alone."""
        atomic.check_writable(self.path, word)

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        return [function(item) for item in items]
