"""Ranges of the wide family: sizes from published dimensions, proportions beyond those of the embedded family.

Length, width, height, wheelbase, ground clearance and tyres run from the least to the largest published value of a body
type (makers' data sheets, `published`). Shares of length and height are our choice, read off side views: those of the
embedded family, each range half as wide again, and of the other body types as written here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from shift3d.vehicles.family.embedded import RANGES, Range, TypeRanges
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

_SHARES: dict[str, tuple[Range, ...]] = {
    # nose, cowl (length, height), roof from, roof to, its drop in metres, rear window, deck, tail, tumblehome in metres
    "city_car": ((0.50, 0.56), (0.19, 0.24), (0.62, 0.66), (0.35, 0.40), (0.86, 0.91), (0.04, 0.09), (0.968, 0.985),
                 (0.64, 0.69), (0.60, 0.65), (0.13, 0.19)),
    "minivan": ((0.45, 0.51), (0.17, 0.22), (0.58, 0.63), (0.31, 0.36), (0.90, 0.94), (0.05, 0.10), (0.975, 0.988),
                (0.58, 0.64), (0.56, 0.62), (0.13, 0.20)),
    "kei_car": ((0.48, 0.54), (0.15, 0.20), (0.56, 0.61), (0.25, 0.32), (0.935, 0.962), (0.02, 0.05), (0.982, 0.99),
                (0.54, 0.60), (0.52, 0.58), (0.05, 0.11)),
    "limousine": ((0.48, 0.53), (0.165, 0.20), (0.64, 0.67), (0.235, 0.275), (0.79, 0.84), (0.05, 0.08),
                  (0.865, 0.90), (0.67, 0.71), (0.66, 0.70), (0.18, 0.24)),
    "high_roof_van": ((0.36, 0.41), (0.105, 0.14), (0.44, 0.48), (0.23, 0.28), (0.965, 0.975), (0.01, 0.04),
                      (0.988, 0.993), (0.42, 0.50), (0.42, 0.50), (0.05, 0.10)),
    # Of the cab's own height.
    "box_van": ((0.45, 0.50), (0.11, 0.14), (0.53, 0.58), (0.20, 0.24), (0.29, 0.33), (0.02, 0.05), (0.34, 0.36),
                (0.30, 0.34), (0.28, 0.32), (0.07, 0.13)),
    "camper": ((0.45, 0.50), (0.11, 0.14), (0.53, 0.58), (0.20, 0.24), (0.27, 0.31), (0.02, 0.05), (0.32, 0.34),
               (0.26, 0.30), (0.25, 0.29), (0.07, 0.13)),
}  # fmt: skip


def wide_ranges(body_type: str) -> TypeRanges:
    """Ranges of a body type; those of a box van or a camper are of its cab, but for length and wheelbase."""
    size = {name: published_range(body_type, name) for name in _SIZES}
    tyre = published_range(body_type, "tyre_diameter_m")
    radius = (tyre[0] / 2, tyre[1] / 2)
    if body_type in RANGES:
        return replace(_widened(RANGES[body_type]), **size, wheel_radius_m=radius)
    if body_type in BOXES:
        size |= {"width_m": BOXES[body_type].cab_width_m, "height_m": BOXES[body_type].cab_height_m}
    nose, cowl_s, cowl_z, roof_from, roof_to, drop, backlight, deck, tail, tumblehome = _SHARES[body_type]
    return TypeRanges(
        **size, wheel_radius_m=radius, nose_of_height=nose, cowl_of_length=cowl_s, cowl_of_height=cowl_z,
        roof_front_of_length=roof_from, roof_rear_of_length=roof_to, roof_drop_m=drop, backlight_of_length=backlight,
        deck_of_height=deck, tail_of_height=tail, tumblehome_m=tumblehome,
    )  # fmt: skip


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
