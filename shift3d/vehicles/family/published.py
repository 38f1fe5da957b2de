"""Published dimensions of production vehicles by body type (``published.csv``), the reference for the families.

Models sold between 2010 and 2025, rounded to a centimetre (ground clearance to 5 mm), written down from general
knowledge; a handful were compared with published pages. After the first comparison, models were added wherever a
quantity of the family was out of range. The table therefore shows that such vehicles exist; it is no independent
test. Width is without mirrors, height without roof rails, for convertibles with the roof closed. Ground clearance is
given if the maker states it, see CLEARANCE_TOLERANCE_M. Tyres are the common size, sidewall code and rim. A limousine
is a stretched sedan: its length is the base car's plus the coachbuilder's stretch. Box vans and campers have the
overall size of the finished vehicle, with the converter's body.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

INCH_M = 0.0254
CLEARANCE_TOLERANCE_M = 0.01
"""Tolerance: makers state ground clearance empty or laden, about 2 cm apart; few state it at all."""
QUANTITIES = ("length_m", "width_m", "height_m", "wheelbase_m", "clearance_m", "tyre_diameter_m")


@dataclass(frozen=True)
class PublishedModel:
    """Production model: outer dimensions in metres, tyre size; clearance_m is None if the maker states none."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    clearance_m: float | None
    tyre: str

    @property
    def tyre_diameter_m(self) -> float:
        """Outer diameter of the unloaded tyre, metres."""
        return tyre_diameter_m(self.tyre)


def tyre_diameter_m(tyre: str) -> float:
    """Compute the diameter of e.g. "205/55 R16", metres: twice the sidewall (55 % of 205 mm) plus the 16-inch rim."""
    width_mm, aspect_percent, rim_inch = map(int, re.split("/| R", tyre))
    return 2e-5 * width_mm * aspect_percent + rim_inch * INCH_M


def _read() -> dict[str, tuple[PublishedModel, ...]]:
    found: dict[str, tuple[PublishedModel, ...]] = {}
    with (Path(__file__).parent / "published.csv").open(encoding="utf-8", newline="") as file:
        for body_type, name, *sizes, clearance, tyre in list(csv.reader(file))[1:]:
            length, width, height, wheelbase = map(float, sizes)
            stated = float(clearance) if clearance else None
            model = PublishedModel(name, length, width, height, wheelbase, stated, tyre)
            found[body_type] = (*found.get(body_type, ()), model)
    return found


PUBLISHED = _read()
TRAILERS: tuple[tuple[str, float, float, float], ...] = (
    ("box trailer of 750 kg, 2.0 m body", 3.20, 1.55, 1.65),
    ("box trailer of 1.3 t, 2.5 m body", 3.90, 1.75, 2.10),
    ("box trailer of 1.5 t, 3.0 m body", 4.50, 1.95, 2.35),
    ("tandem box trailer of 2.7 t, 4.0 m body", 5.60, 2.15, 2.60),
)
"""Name, overall length with the drawbar, width and height of braked box trailers, metres."""


def published_range(body_type: str, quantity: str) -> tuple[float, float]:
    """Return minimum and maximum of a published quantity (one of QUANTITIES), metres; clearance with its tolerance."""
    found = (getattr(model, quantity) for model in PUBLISHED[body_type])
    values = [float(value) for value in found if value is not None]
    tolerance = CLEARANCE_TOLERANCE_M if quantity == "clearance_m" else 0.0
    return min(values) - tolerance, max(values) + tolerance
