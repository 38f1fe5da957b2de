"""User cache folder for recomputable files, each named by a digest of the inputs and the program that make it."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import os
from pathlib import Path

from shift3d.errors import InputError
from shift3d.processor import rounding
from shift3d.store.atomic import write_atomic

# Libraries that can change the last bits of scenes, meshes and scores.
_LIBRARIES = (
    "torch",
    "numpy",
    "pyarrow",
    "scipy",
    "embreex",
    "trimesh",
    "scikit-image",
    "libigl",
    "fast-simplification",
)


def user_cache() -> Path:
    """Return ``shift3d`` in XDG_CACHE_HOME or ~/.cache; the folder may not exist yet."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "shift3d"


def cache_file(folder: str, *made_of: object) -> Path:
    """Return the cache file of a result. made_of: its inputs, see `digest_of`; this machine's `rounding` is added."""
    return user_cache() / folder / digest_of(*made_of, rounding())


def digest_of(*made_of: object) -> str:
    """Return a file name: the digest of the inputs, each given by its `repr`."""
    return _digest(repr(made_of).encode())


def read_cached(file: Path) -> bytes | None:
    """Return the content that `write_cached` wrote; None if the file is absent, torn or changed."""
    try:
        digest, _, content = file.read_bytes().partition(b"\n")
    except OSError:
        return None
    return content if digest.decode(errors="replace") == _digest(content) else None


def cache_result(file: Path, content: bytes) -> None:
    """Write a recomputable result with its digest. An unwritable folder is ignored."""
    with contextlib.suppress(InputError, OSError):
        write_cached(file, content)


def write_cached(file: Path, content: bytes) -> None:
    """Write like `cache_result`, for results that cost work. Raises: InputError: the disk is full or not writable."""
    write_atomic(file, _digest(content).encode() + b"\n" + content)


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


@functools.cache
def source_digest(*parts: str) -> str:
    """Return the BLAKE2b digest of the source and data tables of package parts such as ``scenes`` or ``seeding.py``."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.blake2b(digest_size=16)
    for part in map(package.joinpath, parts):
        for file in sorted(part.rglob("*")) if part.is_dir() else [part]:
            if file.suffix in (".py", ".csv", ".toml"):
                digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    return digest.hexdigest()


@functools.cache
def program_digest(*parts: str, runtime: str = "") -> str:
    """Return the BLAKE2b digest of `source_digest` and of the versions of the libraries that compute cached results.

    runtime: a further library with its version, see `detectors.loading.runtime_of`.
    """
    libraries = [f"{library} {importlib.metadata.version(library)}" for library in _LIBRARIES]
    lines = [*filter(None, [runtime]), *libraries, source_digest(*parts)]
    return hashlib.blake2b("\n".join(lines).encode(), digest_size=16).hexdigest()
