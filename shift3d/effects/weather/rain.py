"""Rain: drops weaken echoes and return their own."""

from __future__ import annotations

from shift3d.effects.weather.precipitation import Particles, Precipitation

DROP_ALBEDO = 0.024
"""Albedo of a diffuse disc as wide as a drop with the same backscatter: a quarter of the backscatter efficiency R (1 +
((1 - R) n / (2 - n))^2) of a large sphere of water, front and rear face, n = 1.33, R = 0.02 (our choice)."""


def drops(rain_mm_h: float) -> Particles:
    """Return the drops of rain, each a disc across the beam. Source: Marshall and Palmer 1948."""
    return Particles(8000.0, 4.1 * rain_mm_h**-0.21, DROP_ALBEDO)


EFFECT = Precipitation("rain", drops)
