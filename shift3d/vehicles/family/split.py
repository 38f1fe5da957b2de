"""Which body types and attributes training sees, and which are held out for attacks and for evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.spec import BODY_TYPES, MORE_BODY_TYPES

WIDE_BODY_TYPES = (*BODY_TYPES, *MORE_BODY_TYPES, "trailer")


@dataclass(frozen=True)
class FamilySplit:
    """Names of body types and attributes, each on one side.

    A vehicle is seen where its body type and all its attributes are; one thing held out makes it held out.
    """

    seen: tuple[str, ...]
    held_out: tuple[str, ...]

    def types(self, side: str) -> tuple[str, ...]:
        """Body types of a side, "seen" or "held_out"."""
        return tuple(name for name in getattr(self, side) if name in WIDE_BODY_TYPES)

    def attributes(self, side: str) -> tuple[str, ...]:
        """Attributes of a side."""
        return tuple(name for name in getattr(self, side) if name in ATTRIBUTES)

    def to_dict(self) -> dict[str, dict[str, list[str]]]:
        """Plain values for the record of a training."""
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
"""What ordinary traffic is made of is seen; what a detector meets seldom is held out."""
