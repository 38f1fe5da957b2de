"""The user's cache folder: what is kept there can be made again, by the program whose digest its name holds."""

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

# Libraries that the last bits of scenes, meshes and scores may depend on.
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
    """``shift3d`` in XDG_CACHE_HOME, or in ~/.cache; it may not be there yet."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "shift3d"


def kept_file(folder: str, *made_of: object) -> Path:
    """The file of the cache folder for what these make, see `digest_of`, as this machine rounds."""
    return user_cache() / folder / digest_of(*made_of, rounding())


def digest_of(*made_of: object) -> str:
    """A file's name for what these make, each told by its `repr`."""
    return _digest(repr(made_of).encode())


def read_kept(file: Path) -> bytes | None:
    """What `write_kept` wrote; None where there is no such file, or one that is torn or has changed since."""
    try:
        digest, _, content = file.read_bytes().partition(b"\n")
    except OSError:
        return None
    return content if digest.decode(errors="replace") == _digest(content) else None


def keep(file: Path, content: bytes) -> None:
    """Write what can be made again, with its digest. A folder that cannot be written is done without."""
    with contextlib.suppress(InputError, OSError):
        write_kept(file, content)


def write_kept(file: Path, content: bytes) -> None:
    """`keep` where work would be lost. Raises: InputError: the disk is full or not writable."""
    write_atomic(file, _digest(content).encode() + b"\n" + content)


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


@functools.cache
def source_digest(*parts: str) -> str:
    """BLAKE2b of the source and the data tables of parts of the package, such as ``scenes`` or ``seeding.py``."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.blake2b(digest_size=16)
    for part in map(package.joinpath, parts):
        for file in sorted(part.rglob("*")) if part.is_dir() else [part]:
            if file.suffix in (".py", ".csv", ".toml"):
                digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    return digest.hexdigest()


@functools.cache
def program_digest(*parts: str) -> str:
    """BLAKE2b of `source_digest` and of the versions of the libraries that what is kept is made with."""
    libraries = [f"{library} {importlib.metadata.version(library)}" for library in _LIBRARIES]
    return hashlib.blake2b("\n".join([*libraries, source_digest(*parts)]).encode(), digest_size=16).hexdigest()
