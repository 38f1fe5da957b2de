"""Pictures as PNG, the same bytes for the same picture; and the colours of methods."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave
from numpy.typing import NDArray

COLOURS = {
    "baseline": "#7d7d7d",
    "random": "#2f8fc9",
    "random_budget": "#9467bd",
    "edited": "#2c9668",
    "adversarial_noise": "#b97a00",
    "adversarial": "#d55e00",
}
"""By method; each at least 3:1 against the light and the dark ground, told apart by who does not see all colours."""


def png(figure: Figure) -> bytes:
    """A matplotlib figure."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": ""})
    return picture.getvalue()


def pixels_png(pixels: NDArray[np.uint8]) -> bytes:
    """Pixels (H, W, 3)."""
    picture = io.BytesIO()
    imsave(picture, pixels, format="png", metadata={"Software": ""})
    return picture.getvalue()
