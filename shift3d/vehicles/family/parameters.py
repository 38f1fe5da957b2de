"""Parameter vectors of wide vehicles: the input from which the parametric decoder's codes are made.

A vector holds body type and attributes (ones and zeros), and every length of chassis and parts. Two vehicles of one
kind differ in the lengths alone, so a search over the lengths yields only vehicles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.parts.damage import PANELS, Dents, MissingPanels
from shift3d.vehicles.family.split import WIDE_BODY_TYPES
from shift3d.vehicles.family.wide import WideSpec

MOST_DENTS = 6
_LOPSIDED = ("ladder", "spare_wheel", "roof_box", "tail_bicycles", "dented", "missing_panels")


def is_symmetric(spec: WideSpec) -> bool:
    """True if left and right are mirror images: no attribute is off-centre."""
    return not any(name in _LOPSIDED for name in spec.attributes)


def named_parameters(spec: WideSpec) -> dict[str, float]:
    """Return every length of a vehicle by name, e.g. "chassis.length_m", "RoofBox.rise_m"; metres, counts as numbers.

    Body type and attributes are not included.
    """
    chassis = {f"chassis.{name}": value for name, value in _numbers(spec.chassis)}
    return chassis | {f"{type(part).__name__}.{name}": value for part in spec.parts for name, value in _numbers(part)}


def _numbers(record: object) -> Iterator[tuple[str, float]]:
    if isinstance(record, Dents):
        # Unused dents are balls of radius zero at the origin.
        balls = [*record.balls, *[(0.0, 0.0, 0.0, 0.0)] * (MOST_DENTS - len(record.balls))]
        for index, ball in enumerate(balls[:MOST_DENTS]):
            yield from ((f"ball_{index}_{axis}_m", value) for axis, value in zip("xyzr", ball, strict=True))
    elif isinstance(record, MissingPanels):
        yield from ((panel, float(panel in record.panels)) for panel in PANELS)
    else:
        assert dataclasses.is_dataclass(record)
        for item in dataclasses.fields(record):
            value = getattr(record, item.name)
            if isinstance(value, float | int):
                yield item.name, float(value)


@dataclass(frozen=True)
class ParameterTable:
    """Table layout for the parameter vectors of a family.

    names: (P,) of the columns: "is:sedan", "has:roof_box", lengths. centre, spread: (P,) mean and standard deviation
    of the columns, in the unit of the parameter, over the vehicles with that parameter. A row holds
    (value - centre) / spread, and 0 for a parameter that the vehicle lacks.
    """

    names: tuple[str, ...]
    centre: NDArray[np.float64]
    spread: NDArray[np.float64]

    def row(self, spec: WideSpec) -> NDArray[np.float64]:
        """Return the parameter vector (P,) of a vehicle."""
        values = named_parameters(spec)
        row = np.zeros(len(self.names))
        for index, name in enumerate(self.names):
            if name.startswith("is:"):
                row[index] = float(name[3:] == spec.body_type)
            elif name.startswith("has:"):
                row[index] = float(name[4:] in spec.attributes)
            elif name in values:
                row[index] = (values[name] - self.centre[index]) / self.spread[index]
        return row

    def rows(self, specs: Sequence[WideSpec]) -> NDArray[np.float64]:
        """Return the parameter vectors (N, P) of vehicles."""
        return np.stack([self.row(spec) for spec in specs])


def parameter_table(specs: Sequence[WideSpec]) -> ParameterTable:
    """Build the table layout for the given vehicles; centre and spread are theirs. Source: our choice."""
    held: dict[str, list[float]] = {}
    for spec in specs:
        for name, value in named_parameters(spec).items():
            held.setdefault(name, []).append(value)
    kinds = [*(f"is:{name}" for name in WIDE_BODY_TYPES), *(f"has:{name}" for name in ATTRIBUTES)]
    lengths = sorted(held)
    centre = [0.0] * len(kinds) + [float(np.mean(held[name])) for name in lengths]
    # A parameter with one value for all vehicles carries no information: its column is 0.
    spread = [1.0] * len(kinds) + [float(np.std(held[name])) or 1.0 for name in lengths]
    return ParameterTable((*kinds, *lengths), np.array(centre), np.array(spread))
