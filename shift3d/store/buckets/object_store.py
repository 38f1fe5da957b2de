"""Files of a sweep in a bucket: Amazon S3, stores with the S3 protocol, and Google Cloud Storage.

An object is always complete or absent. ``If-None-Match`` (S3) or ``x-goog-if-generation-match`` (Google) lets exactly
one of several writers create it; obstore sends these headers, pyarrow's S3 does not. Credentials, region and endpoint
come from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL, AWS_ALLOW_HTTP, or
GOOGLE_SERVICE_ACCOUNT; a machine with a role uses that role.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import GCSStore, S3Store

from shift3d.errors import InputError
from shift3d.store.atomic import UncertainError
from shift3d.store.buckets.object_errors import check_endpoint, store_error
from shift3d.store.location import Item, Location, Result

if TYPE_CHECKING:
    from obstore.store import RetryConfig

STORES = {"s3": ("AWS_", S3Store), "gs": ("GOOGLE_", GCSStore)}
"""By scheme: prefix of the variables in the environment, client."""
_ENDPOINTS = ("AWS_ENDPOINT", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "GOOGLE_BASE_URL")
_THREADS = 16
_IN_ONE_PIECE = 32 * 2**20
_FETCHED_BYTES = 2**20  # minimum size of a range request
# Retries last seconds, not minutes, so that the user soon reads what is wrong. The 6th try starts 6 s after the first.
_RETRY: RetryConfig = {
    "max_retries": 5,
    "retry_timeout": timedelta(seconds=60),
    "backoff": {"init_backoff": timedelta(milliseconds=200), "max_backoff": timedelta(seconds=4), "base": 2},
}
_PATIENCE = {"timeout": "60s", "connect_timeout": "3s"}

_ERRORS = (BaseError, OSError, ValueError, RuntimeError)


def object_location(url: str) -> ObjectLocation:
    """Return the location of ``s3://bucket/prefix`` or ``gs://bucket/prefix``.

    Raises: InputError: another scheme, no bucket, or unusable settings in the environment.
    """
    scheme, _, rest = url.partition("://")
    bucket, _, prefix = rest.partition("/")
    if scheme not in STORES:
        remedy = f"Give a folder, or {' or '.join(f'{known}://BUCKET/PREFIX' for known in STORES)}"
        raise InputError(f"no files are kept under {scheme}://", where=url, remedy=remedy)
    parts = [part for part in prefix.split("/") if part]
    if not bucket or {".", ".."} & set(parts) or not url.isprintable():
        raise InputError("is not the URL of a bucket", where=url, remedy=f"Give {scheme}://BUCKET/PREFIX")
    _store(scheme, bucket)  # finds unusable settings before the sweep is planned
    return ObjectLocation(scheme, bucket, "/".join(parts))


def _store(scheme: str, bucket: str) -> Any:
    """Return the client of a bucket: one per process and set of credentials, since it keeps connections open."""
    settings = ((name, value) for name, value in os.environ.items() if name.startswith(STORES[scheme][0]))
    return _client(scheme, bucket, os.getpid(), tuple(sorted(settings)))


@functools.lru_cache(maxsize=8)
def _client(scheme: str, bucket: str, process: int, settings: tuple[tuple[str, str], ...]) -> Any:
    prefix, client = STORES[scheme]
    for name, value in settings:
        if name in _ENDPOINTS:
            check_endpoint(name, value)
    named = {name for name, _ in settings}
    patience: Any = {name: value for name, value in _PATIENCE.items() if f"{prefix}{name.upper()}" not in named}
    with _clear_errors(f"{scheme}://{bucket}"):
        return client(bucket, config=patience, retry_config=_RETRY)


@contextlib.contextmanager
def _clear_errors(url: str) -> Iterator[None]:
    """Convert errors of obstore to InputError. AlreadyExistsError passes, and FileNotFoundError of an object."""
    try:
        yield
    except AlreadyExistsError:
        raise
    except _ERRORS as error:
        if isinstance(error, FileNotFoundError) and "NoSuchBucket" not in str(error):
            raise FileNotFoundError(url) from error
        raise store_error(error, url) from error


class _Ranges(io.RawIOBase):
    """Object of known size as a file; each read is a request. obstore's own reader lacks methods that pyarrow calls."""

    def __init__(self, location: ObjectLocation, size: int) -> None:
        self._location, self._size, self._at = location, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(start + offset, 0)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        length = min(len(buffer), max(self._size - self._at, 0))
        if length:
            buffer[:length] = self._location.read_range(self._at, length)
            self._at += length
        return length


@dataclass(frozen=True)
class ObjectLocation(Location):
    """Object, or all objects with a common key prefix. key: without the bucket and without slashes at its ends."""

    scheme: str
    bucket: str
    key: str

    def __str__(self) -> str:
        return f"{self.scheme}://{self.bucket}/{self.key}".rstrip("/")

    @property
    def name(self) -> str:
        return self.key.rpartition("/")[2]

    @property
    def _client(self) -> Any:
        return _store(self.scheme, self.bucket)

    def __truediv__(self, part: str) -> ObjectLocation:
        return ObjectLocation(self.scheme, self.bucket, f"{self.key}/{part}".strip("/"))

    def absolute(self) -> ObjectLocation:
        return self

    def is_file(self) -> bool:
        """See `Location`. Also raises InputError if the request fails."""
        try:
            self.size()
        except FileNotFoundError:
            return False
        return True

    def size(self) -> int:
        """See `Location`. Also raises InputError if the request fails."""
        if not self.key:
            raise FileNotFoundError(str(self))
        with _clear_errors(str(self)):
            return int(obstore.head(self._client, self.key)["size"])

    def read_bytes(self) -> bytes:
        """See `Location`. Also raises InputError if the request fails."""
        with _clear_errors(str(self)):
            return bytes(obstore.get(self._client, self.key).bytes())

    def read_range(self, start: int, length: int) -> bytes:
        """Return part of an object. Raises FileNotFoundError or InputError as `read_bytes`."""
        with _clear_errors(str(self)):
            return bytes(obstore.get_range(self._client, self.key, start=start, length=length))

    def open(self) -> Any:
        """See `Location`: fetches only what is read. `open` and reads also raise InputError if a request fails."""
        return io.BufferedReader(_Ranges(self, self.size()), _FETCHED_BYTES)

    def version(self) -> str:
        """See `Location`: size and entity tag. Also raises InputError if the request fails."""
        try:
            with _clear_errors(str(self)):
                state = obstore.head(self._client, self.key)
        except FileNotFoundError:
            return ""
        return f"{state['size']}-{state['e_tag']}"

    def names(self) -> list[str]:
        """See `Location`. Also raises InputError if the request fails."""
        with _clear_errors(str(self)):
            found = obstore.list_with_delimiter(self._client, self.key or None)
        # Web consoles store a folder as an object with the folder's name and a trailing slash.
        objects = (entry["path"] for entry in found["objects"] if entry["path"].rstrip("/") != self.key)
        paths = [*found["common_prefixes"], *objects]
        names = {path.rstrip("/").rpartition("/")[2] for path in paths}
        return sorted(name for name in names if not name.startswith("."))

    def write_atomic(self, content: bytes) -> None:
        """See `Location`. An interrupted upload leaves parts that only the rules of the bucket remove."""
        with _clear_errors(str(self)):
            obstore.put(self._client, self.key, content, use_multipart=len(content) > _IN_ONE_PIECE)

    def put_if_absent(self, content: bytes) -> bool:
        try:
            with _clear_errors(str(self)):
                obstore.put(self._client, self.key, content, mode="create", use_multipart=False)
        except AlreadyExistsError:
            # A retried request whose first answer got lost finds the object that it wrote itself.
            return self._was_created(content)
        except InputError as error:
            return self._was_created(content, error)
        return True

    def _was_created(self, content: bytes, failure: InputError | None = None) -> bool:
        """True if the object has this content. failure: what the store answered to the request that creates it."""
        try:
            return self.read_bytes() == content
        except (FileNotFoundError, InputError) as error:
            # The object is absent or the store is silent: the request may still arrive.
            reason = failure or (error if isinstance(error, InputError) else InputError("is gone again", str(self)))
            raise UncertainError(reason.what, reason.where, reason.remedy) from reason

    def delete(self) -> None:
        with _clear_errors(str(self)), contextlib.suppress(FileNotFoundError):
            obstore.delete(self._client, self.key)

    def leftovers(self) -> list[Location]:
        """See `Location`: always empty, since no object is half-written."""
        return []

    def check_writable(self, word: str = "") -> None:
        """See `Location`: tries a probe twice, since some stores ignore the condition (two drivers, one entry)."""
        probe = self / f".probe-{secrets.token_hex(8)}"
        try:
            if probe.put_if_absent(b"first") and not probe.put_if_absent(b"second"):
                return
        finally:
            with contextlib.suppress(InputError):
                probe.delete()
        what = "this store overwrites an object that was to be created only if absent: two drivers would not notice"
        remedy = "Use one that honours If-None-Match (AWS S3, Google Cloud Storage, a recent MinIO), or a folder"
        raise InputError(what, where=str(self), remedy=remedy)

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        if len(items) < 2:
            return [function(item) for item in items]
        with ThreadPoolExecutor(_THREADS) as threads:
            return list(threads.map(function, items))
