"""Deterministic PNG output, and the colours of methods."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave
from numpy.typing import NDArray

# By method; contrast of at least 3:1 against light and dark backgrounds, distinguishable with colour blindness.
COLOURS = {
    "baseline": "#7d7d7d",
    "random": "#2f8fc9",
    "random_budget": "#9467bd",
    "edited": "#2c9668",
    "adversarial_noise": "#b97a00",
    "adversarial": "#d55e00",
}


def png(figure: Figure) -> bytes:
    """Encode a matplotlib figure as PNG."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": ""})
    return picture.getvalue()


def pixels_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode pixels (H, W, 3) as PNG."""
    picture = io.BytesIO()
    imsave(picture, pixels, format="png", metadata={"Software": ""})
    return picture.getvalue()
