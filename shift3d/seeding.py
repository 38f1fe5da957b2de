"""Seeds derived from names, independent of the order of tasks and of processes."""

from __future__ import annotations

import hashlib

import numpy as np


def derive_seed(*parts: str | int) -> int:
    """Derive a 64-bit seed from a sequence of names and numbers.

    A length prefix of each part makes ``("ab", "c")`` and ``("a", "bc")`` differ.

    Source: our choice (design section 9: the seed of a task comes from its id).
    """
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        text = f"{type(part).__name__}:{part}".encode()
        digest.update(len(text).to_bytes(4, "little") + text)
    return int.from_bytes(digest.digest(), "little")


def generator(*parts: str | int) -> np.random.Generator:
    """Create a NumPy generator seeded by :func:`derive_seed` of the same parts."""
    return np.random.Generator(np.random.PCG64(derive_seed(*parts)))
