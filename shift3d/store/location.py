"""Where a sweep's files lie: a folder of this machine's file systems, or a prefix of a bucket.

Both give the commit log what it rests on: a file is there whole or not at all, and of several writers of one new name
exactly one succeeds. pyarrow's file systems are not used, since their S3 has no put that fails where a file is there.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from shift3d.errors import InputError
from shift3d.store import atomic

__all__ = ["LocalLocation", "Location", "Place", "UncertainError", "as_location", "local_copy"]

UncertainError = atomic.UncertainError
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
    def names(self) -> list[str]:
        """Names of the files and folders in it, in order, without hidden ones; none where there is no such folder.

        Raises:
            NotADirectoryError: something else is there.
        """

    @abstractmethod
    def write_atomic(self, content: bytes) -> None:
        """Write a file: whole, or as it was before.

        Raises:
            InputError: it cannot be written; the message says what to do.
        """

    @abstractmethod
    def put_if_absent(self, content: bytes) -> bool:
        """Create a file in one step, unless there is one. True where its content is now the given one.

        An answer may get lost after the file was created: then a second try finds it there. So writers whose place
        among others matters must put their own name into the content.

        Raises:
            UncertainError: nobody can say whether it was created. InputError: it was not, and cannot be.
        """

    @abstractmethod
    def delete(self) -> None:
        """Remove a file where there is one."""

    @abstractmethod
    def leftovers(self) -> list[Location]:
        """Files in this folder that writers which no longer run left half-written."""

    @abstractmethod
    def check_writable(self) -> None:
        """Make sure that `put_if_absent` has one winner here.

        Raises:
            InputError: it has not, or nothing can be written.
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


Place = Location | Path | str
"""What functions that read or write a sweep's folder take: a location, a path, or either of them as text."""


def as_location(place: Place) -> Location:
    """A path, ``s3://bucket/prefix`` or ``gs://bucket/prefix`` as a location. Of text, ~ is the home folder.

    Raises:
        InputError: the text is empty, the URL has no bucket or another scheme, or settings in the environment cannot be
            used.
    """
    if isinstance(place, Location):
        return place
    if place == "":
        raise InputError("the name of a folder is empty", remedy="Give one; is a variable of the shell unset?")
    if isinstance(place, str) and "://" in place:
        from shift3d.store.object_store import object_location  # late: obstore is not needed for folders

        return object_location(place)
    return LocalLocation(Path(place).expanduser() if isinstance(place, str) else place)


@contextlib.contextmanager
def local_copy(folder: Place, names: Sequence[str]) -> Iterator[Path]:
    """A folder of this machine that holds the named files and folders of a location, while this is open.

    For libraries that read paths alone. A local folder is given as it is, with whatever else it holds.

    Raises:
        InputError: they cannot be read. FileNotFoundError: a file that was listed is gone.
    """
    location = as_location(folder)
    if isinstance(location, LocalLocation):
        yield location.path
        return
    with tempfile.TemporaryDirectory(prefix="shift3d-") as temporary:
        for name in names:
            _fetch(location / name, Path(temporary) / name)
        yield Path(temporary)


def _fetch(source: Location, target: Path) -> None:
    if source.is_file():
        target.write_bytes(source.read_bytes())
        return
    target.mkdir()
    for name in source.names():
        _fetch(source / name, target / name)
