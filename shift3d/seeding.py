"""Seeds that depend on names, never on the order or the process in which something runs."""

from __future__ import annotations

import hashlib

import numpy as np


def derive_seed(*parts: str | int) -> int:
    """A 64-bit seed from a path of names and numbers.

    Each part is length-prefixed before hashing, so that ``("ab", "c")`` and ``("a", "bc")`` differ.

    Source: our choice (design section 9: the seed of a task comes from its id).
    """
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        text = f"{type(part).__name__}:{part}".encode()
        digest.update(len(text).to_bytes(4, "little") + text)
    return int.from_bytes(digest.digest(), "little")


def generator(*parts: str | int) -> np.random.Generator:
    """A NumPy generator seeded by :func:`derive_seed` of the same parts."""
    return np.random.Generator(np.random.PCG64(derive_seed(*parts)))
