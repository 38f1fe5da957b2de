"""Ranges of the wide family: sizes from published dimensions, proportions beyond those of the embedded family.

Length, width, height, wheelbase, ground clearance and tyres run from the least to the largest published value of a body
type (makers' data sheets, `published`). Shares of length and height are our choice, read off side views: those of the
embedded family, each range half as wide again, and of the other body types as ``ranges.csv`` has them (of a box van or
a camper: of the cab's own height).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from shift3d.vehicles.family.embedded import RANGES, Range, TypeRanges, read_ranges
from shift3d.vehicles.family.published import TRAILERS, published_range

WIDENED = 0.25
"""Of its width a range of shares is extended by at either end."""


@dataclass(frozen=True)
class BoxRanges:
    """Of a body behind a cab: overall width and height, and the cab's own width and height, metres."""

    width_m: Range
    height_m: Range
    cab_width_m: Range = (2.00, 2.05)
    cab_height_m: Range = (2.12, 2.32)


@dataclass(frozen=True)
class TrailerRanges:
    """Of a trailer, metres: outer length, width and height (makers' data sheets); drawbar, floor and wheels (ours)."""

    length_m: Range
    width_m: Range
    height_m: Range
    drawbar_m: Range = (1.10, 1.45)
    floor_m: Range = (0.45, 0.62)
    wheel_radius_m: Range = (0.26, 0.32)


def _published_box(body_type: str) -> BoxRanges:
    return BoxRanges(published_range(body_type, "width_m"), published_range(body_type, "height_m"))


def _span(column: int) -> Range:
    values = [float(row[column]) for row in TRAILERS]
    return min(values), max(values)


BOXES: dict[str, BoxRanges] = {body_type: _published_box(body_type) for body_type in ("box_van", "camper")}
TRAILER = TrailerRanges(_span(1), _span(2), _span(3))


def wide_ranges(body_type: str) -> TypeRanges:
    """Ranges of a body type; those of a box van or a camper are of its cab, but for length and wheelbase."""
    size = {name: published_range(body_type, name) for name in _SIZES}
    tyre = published_range(body_type, "tyre_diameter_m")
    radius = (tyre[0] / 2, tyre[1] / 2)
    if body_type in RANGES:
        return replace(_widened(RANGES[body_type]), **size, wheel_radius_m=radius)
    if body_type in BOXES:
        size |= {"width_m": BOXES[body_type].cab_width_m, "height_m": BOXES[body_type].cab_height_m}
    return TypeRanges(**size, wheel_radius_m=radius, **read_ranges()[body_type])


_SIZES = ("length_m", "width_m", "height_m", "wheelbase_m", "clearance_m")
_PROPORTIONS = (
    "nose_of_height", "cowl_of_length", "cowl_of_height", "roof_front_of_length", "roof_rear_of_length", "roof_drop_m",
    "backlight_of_length", "deck_of_height", "tail_of_height", "tumblehome_m",
)  # fmt: skip


def _widened(ranges: TypeRanges) -> TypeRanges:
    wider = {}
    for name in _PROPORTIONS:
        low, high = getattr(ranges, name)
        more = WIDENED * (high - low)
        wider[name] = (max(low - more, 0.0), min(high + more, 0.993) if name.endswith("_of_length") else high + more)
    return replace(ranges, **wider)
