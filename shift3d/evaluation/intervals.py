"""Confidence intervals by bootstrap over frames, because vehicles of one frame are not independent samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from shift3d.seeding import generator

Floats = npt.NDArray[np.float64]

CONFIDENCE = 0.95
DRAWS = 500


def frame_weights(num_frames: int, draws: int = DRAWS) -> Floats:
    """Count draws per frame, (draws, F): F with replacement per row; (0, F) if F < 2. The arguments are the seed."""
    if num_frames < 2:
        return np.zeros((0, num_frames))
    rng = generator("evaluation frames", num_frames, draws)
    share = np.full(num_frames, 1.0 / num_frames)
    return rng.multinomial(num_frames, share, size=draws).astype(np.float64)


def interval(values: Iterable[float | None]) -> tuple[float | None, float | None]:
    """Compute the 95 % interval of a statistic from its values over resampled frames; skip None.

    Returns (None, None) for fewer than two values. Source: Efron's percentile bootstrap, frames resampled as clusters.
    """
    known = [value for value in values if value is not None]
    if len(known) < 2:
        return None, None
    low, high = np.percentile(known, (50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)))
    return float(low), float(high)


def weighted_median(ordered: Floats, weights: Floats) -> float | None:
    """Return the lowest of ascending values (N,) at which half of the weight (N,) is reached; None without weight."""
    if not len(ordered) or weights.sum() <= 0.0:
        return None
    total = np.cumsum(weights)
    return float(ordered[np.searchsorted(total, 0.5 * total[-1])])
