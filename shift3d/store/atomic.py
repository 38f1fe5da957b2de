"""Atomic file writes: a file is complete or absent, even after a kill or on a full disk."""

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
# .tmp-<process id>-<machine hash><random part>-<final name>; older programs omit the middle part.
_OWNER = re.compile(r"\.tmp-(\d+)-(?:([0-9a-f]{8})[0-9a-f]{8}-)?")


class DiskFullError(InputError):
    """Error for an exhausted disk, quota or size limit: with free space the same command works or resumes."""


class UncertainError(InputError):
    """Error for a file that may or may not have been created: files that its content names must not be removed."""


def write_atomic(path: Path, write: bytes | Callable[[Path], None]) -> None:
    """Write a temporary file, flush it to disk, and rename it to ``path``.

    Args:
        path: final name; an existing file is replaced in one step.
        write: the bytes, or a function that writes the file of the given name.

    Raises: InputError: the disk is full or not writable. The old file is kept, unless only the folder's flush failed.
    """
    temporary = _temporary(path)
    with _clear_disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _fill(temporary, write)
            temporary.replace(path)
        finally:
            with contextlib.suppress(OSError):  # an earlier failure is the one to report
                temporary.unlink(missing_ok=True)
        _flush(path.parent)


def put_if_absent(path: Path, content: bytes) -> bool:
    """Create ``path`` with ``content`` in one step unless it exists. Return True if the file has this content.

    The file is a hard link to a complete temporary file: unlike with O_EXCL, a kill cannot leave a torn file. A network
    file system may lose its answer after it made the link, so the content of an existing file is compared.

    Raises:
        InputError: the disk is full or not writable; neither the temporary file nor ``path`` is left.
        UncertainError: the folder cannot be flushed, so the file may be absent after a power cut.
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
            with contextlib.suppress(OSError):  # a temporary file that stays does no harm; `gc` removes it
                temporary.unlink(missing_ok=True)


def check_writable(folder: Path, word: str = "") -> None:
    """Check that a folder can be written to, or created, by a trial in the nearest existing folder.

    word: setting of the command that names another folder, for the message; empty without one.
    Raises: InputError: the folder cannot be written to; the message says what to do.
    """
    with _clear_disk_errors(folder, word):
        nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=nearest)).rmdir()


def leftovers(folder: Path) -> list[Path]:
    """Return the temporary files that killed processes of this machine left in ``folder``."""
    if not folder.is_dir():
        return []
    found = []
    for entry in folder.glob(f"{_TEMPORARY}*"):
        owner = _OWNER.match(entry.name)
        if owner and owner[2] in (None, _machine()) and not Path(f"/proc/{owner[1]}").exists():
            found.append(entry)
    return found


def _temporary(path: Path) -> Path:
    """Return a name that no other thread, process or machine uses."""
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
    """Flush the content of a file, or the names in a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_FULL = {
    errno.ENOSPC: ("the disk is full", "Free some space and run the same command again"),
    errno.EDQUOT: ("the disk quota is used up", "Free some space and run the same command again"),
    errno.EFBIG: ("the file would pass the size limit", "Raise the limit (ulimit -f) and run the same command again"),
}
_REFUSED = {
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "no permission to write here",
    errno.ENOTDIR: "part of this path is a file, not a folder",
}

_COPY = "Make it writable, or work on a copy in another folder"


@contextlib.contextmanager
def _clear_disk_errors(path: Path, word: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if (full := _full(error, str(path))) is not None:
            raise full from error
        what = _REFUSED.get(error.errno or 0, f"nothing can be written here ({error.strerror or error})")
        raise InputError(what, str(path), f"Choose another folder with {word}" if word else _COPY) from error


def disk_error(error: OSError) -> InputError | None:
    """Return the InputError for a full or read-only disk that a library met; None for other errors."""
    where = str(error.filename or "")
    if error.errno == errno.EROFS:
        return InputError(_REFUSED[errno.EROFS], where, _COPY)
    return _full(error, where)


def _full(error: OSError, where: str) -> DiskFullError | None:
    return DiskFullError(_FULL[error.errno][0], where, _FULL[error.errno][1]) if error.errno in _FULL else None
