"""One scale of reflectance: recognised or given, never a scene's own, and refused for another unit."""

from __future__ import annotations

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.scenes.reflectance import MOST_RAW, STRAY_SHARE, full_reflectance

WHERE = "frame.bin"


def fractions(count: int = 200) -> np.ndarray:
    return np.linspace(0.0, 0.99, count, dtype=np.float32)


def whole(largest: int = 255, count: int = 200) -> np.ndarray:
    return np.round(np.linspace(0.0, largest, count)).astype(np.float32)


def test_scales_are_recognised() -> None:
    assert full_reflectance(fractions(), WHERE) == 1.0
    assert full_reflectance(whole(), WHERE) == 255.0
    assert full_reflectance(np.zeros(5, np.float32), WHERE) == 1.0
    dark = whole(1)
    dark[7] = 20.0  # one bright return of a frame of whole numbers
    assert full_reflectance(dark, WHERE) == 255.0
    flipped = fractions()
    flipped[7] = 3e38
    assert full_reflectance(flipped, WHERE) == 1.0


@pytest.mark.parametrize("values", [whole(60_000), -whole(3), fractions() * 100, -fractions() - 0.1, fractions() * 1e5])
def test_what_is_on_neither_scale_is_refused(values: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"frame\.bin: row \d+ has reflectance .* not on either") as caught:
        full_reflectance(values, WHERE, remedy="Say what is full")
    assert caught.value.remedy == "Say what is full"
    row = int(caught.value.what.split()[1])
    assert not (0.0 <= values[row] <= 1.0)


def test_a_raw_scale_is_the_stated_one_and_not_the_scenes() -> None:
    """Two scenes of one sensor, one without any bright return, are divided by the same number."""
    assert full_reflectance(whole(60_000), WHERE, 65535.0) == full_reflectance(whole(900), WHERE, 65535.0) == 65535.0


@pytest.mark.parametrize("stated", [1.0, 255.0, 65535.0])
def test_few_values_beyond_the_scale_are_strays_and_many_are_another_scale(stated: float) -> None:
    values = np.linspace(0.0, stated, 1000).astype(np.float32)
    few, many = int(STRAY_SHARE * 1000), int(STRAY_SHARE * 1000) + 1
    values[:few] = 3e38
    assert full_reflectance(values, WHERE, stated) == stated
    values[100 : 100 + many] = 3.0 * stated
    with pytest.raises(InputError, match=rf"not on the scale 0 to {stated:g} "):
        full_reflectance(values, WHERE, stated)


def test_fractions_below_one_are_not_on_a_scale_of_255() -> None:
    with pytest.raises(InputError, match=r"row 1 has reflectance 0\.00\d+, not on the scale 0 to 255"):
        full_reflectance(fractions(), WHERE, 255.0)
    assert full_reflectance(whole(1), WHERE, 255.0) == 255.0  # a dark frame
    assert full_reflectance(whole(255) * 0.5, WHERE, 255.0) == 255.0  # halves, but far beyond 1


@pytest.mark.parametrize("stated", [0.0, -1.0, 2 * MOST_RAW, float("nan"), float("inf")])
def test_no_sensor_has_such_a_maximum(stated: float) -> None:
    with pytest.raises(InputError, match="largest reflectance"):
        full_reflectance(fractions(), WHERE, stated)
