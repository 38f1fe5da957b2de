"""The prefilter: which members of a reference set can be the nearest, from distances at fixed places around a vehicle.

Source: our choice. A surface that moves by a centimetre changes the distance of the places near it by about as much, so
the mean difference of two fingerprints rises with the distance of the surfaces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.naturalness.surface import Surface

__all__ = ["PROBES", "fingerprint", "likely_nearest"]

_SPACING_M, _REACH_M = 0.25, 0.5
PROBES: NDArray[np.float64] = np.stack(
    np.meshgrid(
        np.arange(-3.0, 3.01, _SPACING_M), np.arange(-1.25, 1.26, _SPACING_M), np.arange(0.125, 2.4, _SPACING_M),
        indexing="ij",
    ),
    axis=-1,
).reshape(-1, 3)  # fmt: skip
"""Places (P, 3), metres, frame of `Surface`. Longer and higher vehicles are told apart by what lies within."""


def fingerprint(surface: Surface) -> NDArray[np.uint8]:
    """Distance (P,) of every probe to the surface, in 255ths of half a metre."""
    return np.asarray(np.rint(surface.nearest_points_m(PROBES, _REACH_M) * (255.0 / _REACH_M)), np.uint8)


def likely_nearest(
    own: NDArray[np.uint8], members: NDArray[np.uint8], count: int, left_out: int | None = None
) -> NDArray[np.int64]:
    """Numbers of the `count` members (M, P) whose fingerprints differ least from `own` (P,), nearest first.

    left_out: a member that is passed over.
    """
    differences = np.empty(len(members), np.int64)
    for start in range(0, len(members), 256):
        part = members[start : start + 256].astype(np.int16)
        differences[start : start + 256] = np.abs(part - own.astype(np.int16)).sum(axis=1, dtype=np.int64)
    if left_out is not None:
        differences[left_out] = np.iinfo(np.int64).max
    return np.argsort(differences, kind="stable")[: min(count, len(members) - (left_out is not None))]
