"""Conversion of paths and URLs to locations."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from shift3d.errors import InputError
from shift3d.store.buckets.object_errors import CHECK
from shift3d.store.location import LocalLocation, Location

LocationLike = Location | Path | str
"""Argument of functions that read or write a sweep's folder: a location, a path, or a path or URL as text."""


def as_location(place: LocationLike) -> Location:
    """Return the location of a path, ``s3://bucket/prefix`` or ``gs://bucket/prefix``. In text, ~ is the home folder.

    Raises: InputError: the text is empty or not UTF-8, its ~user is unknown, the URL lacks its slashes or has no bucket
    or another scheme, or settings in the environment are unusable.
    """
    if isinstance(place, Location):
        return place
    if isinstance(place, str) and not place.strip():
        raise InputError("the name of a folder is empty", remedy="Give one; is a variable of the shell unset?")
    try:
        str(place).encode()
    except UnicodeEncodeError:
        what = "the name is not UTF-8: neither settings nor Parquet readers can hold it"
        raise InputError(what, str(place), "Rename the folder, or set LANG=C.UTF-8") from None
    if isinstance(place, str) and "://" in place:
        from shift3d.store.buckets.object_store import object_location  # late: folders need no obstore

        return object_location(place)
    scheme, colon, _ = str(place).partition(":")
    if isinstance(place, str) and colon and scheme in CHECK:
        remedy = f"Give {scheme}://BUCKET/PREFIX; a folder: ./{place}"
        raise InputError("is neither a URL nor a folder", place, remedy)
    try:
        return LocalLocation(Path(place).expanduser() if isinstance(place, str) else place)
    except RuntimeError:
        raise InputError("there is no such user", str(place), "Give another path") from None


@contextlib.contextmanager
def local_copy(folder: LocationLike, names: Sequence[str]) -> Iterator[Path]:
    """Yield a temporary local folder with copies of the named files and folders, for libraries that read paths only.

    A local folder is yielded itself, with all that it holds.

    Raises: InputError: the files cannot be read. FileNotFoundError: a listed file is gone.
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
