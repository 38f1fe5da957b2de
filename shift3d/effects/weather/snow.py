"""Snow: flakes block part of the beam and send light back."""

from __future__ import annotations

from shift3d.effects.weather.precipitation import Particles, Precipitation

FLAKE_WIDTH = 2.1
"""Width of a flake, as a disc without holes, over that of its melted drop. Our choice: 1 mm/h then gives a visibility
of 0.9 km and 2.5 mm/h of 0.6 km; weather services bound moderate snow by 1 km and 0.5 km."""
FLAKE_ALBEDO = 0.25
"""Albedo of a diffuse disc with the same backscatter: 2 pi / 25, from ice crystals' ratio of extinction to backscatter,
some 25 sr (our choice)."""


def flakes(snow_mm_h: float) -> Particles:
    """Return the flakes of snow by width, each a disc across the beam; the rate is that of melted water.

    Source: Gunn and Marshall 1958, whose diameters are those of the melted drops. Their density carries 1.02 R^1.05
    mm/h of water at a fall of 1 m/s. LISA (Kilic et al. 2021) has twice that density.
    """
    return Particles(3800.0 * snow_mm_h**-0.87 / FLAKE_WIDTH, 2.55 * snow_mm_h**-0.48 / FLAKE_WIDTH, FLAKE_ALBEDO)


EFFECT = Precipitation("snow", flakes)
