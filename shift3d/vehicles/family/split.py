"""Split of body types and attributes into seen ones for training and held-out ones for attacks and evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.spec import BODY_TYPES, MORE_BODY_TYPES

WIDE_BODY_TYPES = (*BODY_TYPES, *MORE_BODY_TYPES, "trailer")


@dataclass(frozen=True)
class FamilySplit:
    """Names of body types and attributes, each on one side of the split.

    A vehicle is seen if its body type and all its attributes are seen. One held-out name makes it held out.
    """

    seen: tuple[str, ...]
    held_out: tuple[str, ...]

    def types(self, side: str) -> tuple[str, ...]:
        """Return the body types of a side, "seen" or "held_out"."""
        return tuple(name for name in getattr(self, side) if name in WIDE_BODY_TYPES)

    def attributes(self, side: str) -> tuple[str, ...]:
        """Return the attributes of a side."""
        return tuple(name for name in getattr(self, side) if name in ATTRIBUTES)

    def to_dict(self) -> dict[str, dict[str, list[str]]]:
        """Return plain values for the training record."""
        return {
            side: {"body_types": list(self.types(side)), "attributes": list(self.attributes(side))}
            for side in ("seen", "held_out")
        }


SPLIT = FamilySplit(
    seen=(*BODY_TYPES, "city_car", "minivan", "roof_rails", "roof_rack", "ladder", "spare_wheel", "canopy"),
    held_out=(
        "kei_car", "limousine", "high_roof_van", "box_van", "camper", "trailer",
        "roof_box", "tail_bicycles", "open_tailgate", "lifted", "dented", "missing_panels",
    ),
)  # fmt: skip
"""Seen are the vehicles of ordinary traffic; held out are the ones that a detector rarely meets."""
