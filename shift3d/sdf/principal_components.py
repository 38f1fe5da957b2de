"""Principal components of known latent codes, and the radius of the ball that contains most Gaussian draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv  # scipy.stats takes a second to import

from shift3d.errors import InputError
from shift3d.wording import counted

Array = NDArray[np.float64]
_BALL = 0.95


def ball_radius(components: int) -> float:
    """Compute the radius, in standard deviations, of the ball with 95 % of a Gaussian's draws in k dimensions.

    The radius is the square root of the chi-squared quantile. Source: the share is our choice.
    """
    return float(np.sqrt(2.0 * gammaincinv(components / 2, _BALL)))


def principal_components(
    codes: NDArray[np.float32], components: int, where: str, setting: str = ""
) -> tuple[Array, Array, Array]:
    """Compute mean (d,), standard deviations (k,) and unit vectors (k, d) of the first principal components.

    codes: (N, d). where: origin of the codes, for messages. setting: name of the setting of `components`, if any.
    Raises: InputError for fewer than k + 2 codes, or codes that do not spread along k components.
    """
    if len(codes) < components + 2:
        what = f"{counted(len(codes), 'code')}: too few for {counted(components, 'component')}"
        fewer = f"{setting}={len(codes) - 2} or less, or " if len(codes) > 2 and setting else ""
        raise InputError(what, where, f"Give {fewer}more vehicles")
    mean = codes.astype(np.float64).mean(axis=0)
    _, spread, axes = np.linalg.svd(codes - mean, full_matrices=False)
    spread = spread[:components] / np.sqrt(len(codes) - 1)
    if len(spread) < components or not spread[-1] > 1e-6 * spread[0]:
        raise InputError(f"the codes do not spread along {components} directions", where, "Give fewer components")
    return mean, spread, axes[:components]
