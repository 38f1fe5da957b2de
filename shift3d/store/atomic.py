"""Files that are there whole or not at all, whatever is killed or full."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import socket
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from shift3d.errors import InputError

_TEMPORARY = ".tmp-"
# .tmp-<process>-<machine><one use>-<final name>; earlier programs left the middle part out.
_OWNER = re.compile(r"\.tmp-(\d+)-(?:([0-9a-f]{8})[0-9a-f]{8}-)?")


class DiskFullError(InputError):
    """There is no room: the same command goes through where there is some, and a command that resumes goes on."""


class UncertainError(InputError):
    """A file was to be created, and nobody can say whether it was: what it names must not be removed."""


def write_atomic(path: Path, write: bytes | Callable[[Path], None]) -> None:
    """Write a file under a temporary name, flush it to the disk, and rename it to ``path``.

    Args:
        path: final name; an existing file is replaced in one step.
        write: the bytes, or a function that writes the file it is given the name of.

    Raises: InputError: the disk is full or not writable; nothing is left under either name.
    """
    temporary = _temporary(path)
    with _clear_disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _fill(temporary, write)
            temporary.replace(path)
        finally:
            with contextlib.suppress(OSError):  # what failed before is the error
                temporary.unlink(missing_ok=True)
        _flush(path.parent)


def put_if_absent(path: Path, content: bytes) -> bool:
    """Create ``path`` with ``content`` in one step, unless it exists. True where its content is now the given one.

    A hard link from a complete temporary file: unlike O_EXCL, a kill cannot leave a torn file under the name. On a
    network's file system the answer may get lost after the link was made, so what is there is compared.

    Raises:
        InputError: the disk is full or not writable; nothing is left under either name.
        UncertainError: the folder cannot be flushed, so the file may or may not be there after a power cut.
    """
    temporary = _temporary(path)
    with _clear_disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _fill(temporary, content)
            try:
                os.link(temporary, path)
            except FileExistsError:
                return path.read_bytes() == content
            try:
                _flush(path.parent)
            except OSError as error:
                what = f"cannot be flushed to the disk ({error.strerror})"
                raise UncertainError(what, str(path), "Check the disk and run the same command again") from error
            return True
        finally:
            temporary.unlink(missing_ok=True)


def check_writable(folder: Path, word: str = "out=DIR") -> None:
    """Make sure that a folder can be written to, or made. It is tried in the nearest folder that there is.

    word: what names another folder, for the message.

    Raises: InputError: it cannot; the message says what to do.
    """
    with _clear_disk_errors(folder, word):
        nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=nearest)).rmdir()


def leftovers(folder: Path) -> list[Path]:
    """Temporary files that killed processes of this machine left in ``folder``."""
    if not folder.is_dir():
        return []
    found = []
    for entry in folder.glob(f"{_TEMPORARY}*"):
        owner = _OWNER.match(entry.name)
        if owner and owner[2] in (None, _machine()) and not Path(f"/proc/{owner[1]}").exists():
            found.append(entry)
    return found


def _temporary(path: Path) -> Path:
    """A name that no other thread, process or machine uses."""
    return path.with_name(f"{_TEMPORARY}{os.getpid()}-{_machine()}{secrets.token_hex(4)}-{path.name}")


def _machine() -> str:
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def _fill(path: Path, write: bytes | Callable[[Path], None]) -> None:
    if isinstance(write, bytes):
        path.write_bytes(write)
    else:
        write(path)
    _flush(path)


def _flush(path: Path) -> None:
    """A file's content to the disk, or a folder's names."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_ELSEWHERE = "Choose another folder with {}"
_FULL = {
    errno.ENOSPC: ("the disk is full", "Free some space and run the same command again"),
    errno.EDQUOT: ("the disk quota is used up", "Free some space and run the same command again"),
    errno.EFBIG: ("the file would pass the size limit", "Raise the limit (ulimit -f) and run the same command again"),
}
_REFUSED = {
    errno.EROFS: ("the file system is read-only", _ELSEWHERE),
    errno.EACCES: ("no permission to write here", _ELSEWHERE),
    errno.ENOTDIR: ("part of this path is a file, not a folder", _ELSEWHERE),
}


@contextlib.contextmanager
def _clear_disk_errors(path: Path, word: str = "out=DIR") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if (full := _full(error, str(path))) is not None:
            raise full from error
        unknown = f"nothing can be written here ({error.strerror or error})", _ELSEWHERE
        what, remedy = _REFUSED.get(error.errno or 0, unknown)
        raise InputError(what, where=str(path), remedy=remedy.format(word)) from error


def disk_error(error: OSError) -> InputError | None:
    """The line for what a disk refuses a library that writes by itself; None for other errors."""
    where = str(error.filename or "")
    if error.errno == errno.EROFS:
        what, remedy = _REFUSED[errno.EROFS]
        return InputError(what, where, remedy.format("out=DIR"))
    return _full(error, where)


def _full(error: OSError, where: str) -> DiskFullError | None:
    return DiskFullError(_FULL[error.errno][0], where, _FULL[error.errno][1]) if error.errno in _FULL else None
