"""Which body types and attributes training sees, and which are held out for attacks and for evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from shift3d.errors import InputError
from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.spec import BODY_TYPES, MORE_BODY_TYPES

WIDE_BODY_TYPES = (*BODY_TYPES, *MORE_BODY_TYPES, "trailer")
_EVERY = (*WIDE_BODY_TYPES, *ATTRIBUTES)


@dataclass(frozen=True)
class FamilySplit:
    """Names of body types and attributes, each on one side.

    A vehicle is seen where its body type and all its attributes are; one thing held out makes it held out.

    Raises InputError: for a name that is unknown or given twice, on both sides or on none, or no body type to train on.
    """

    seen: tuple[str, ...]
    held_out: tuple[str, ...]

    def __post_init__(self) -> None:
        for side in ("seen", "held_out"):
            names: tuple[str, ...] = getattr(self, side)
            where = f"vehicle split, {side}"
            for name in names:
                if name not in _EVERY:
                    raise InputError(f"unknown {name!r}", where, f"Choose from {', '.join(_EVERY)}")
                if names.count(name) > 1:
                    raise InputError(f"{name} is given twice", where, "Give it once")
        both = [name for name in self.seen if name in self.held_out]
        if both:
            what = f"{', '.join(both)} both seen and held out"
            raise InputError(
                what, "vehicle split", "Leave each name on one side: training must not see what attacks use"
            )
        missing = [name for name in _EVERY if name not in self.seen + self.held_out]
        if missing:
            what = f"{', '.join(missing)} on neither side"
            raise InputError(what, "vehicle split", "Name every body type and attribute in seen or held_out")
        if not self.types("seen"):
            raise InputError("no body type is seen", "vehicle split", f"Name some of {', '.join(WIDE_BODY_TYPES)}")

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

    def is_seen(self, kind: str) -> bool:
        """Whether training sees a kind such as "sedan" or "suv+roof_box". Raises InputError for an unknown name."""
        names = kind.split("+")
        for name in names:
            if name not in _EVERY:
                raise InputError(f"unknown {name!r} in {kind!r}", "vehicle kind", f"Choose from {', '.join(_EVERY)}")
        return all(name in self.seen for name in names)


SPLIT = FamilySplit(
    seen=(*BODY_TYPES, "city_car", "minivan", "roof_rails", "roof_rack", "ladder", "spare_wheel", "canopy"),
    held_out=(
        "kei_car", "limousine", "high_roof_van", "box_van", "camper", "trailer",
        "roof_box", "tail_bicycles", "open_tailgate", "lifted", "dented", "missing_panels",
    ),
)  # fmt: skip
"""What ordinary traffic is made of is seen; what a detector meets seldom is held out."""
