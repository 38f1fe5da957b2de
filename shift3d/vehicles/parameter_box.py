"""The parameters that a vehicle's code is made of, and how far each may go: tensors beside the vehicle's code.

For vehicle NAME, `NAME.parameters.basis` (k, code), `.start`, `.low` and `.high` (k,), float32; their names stand in
the metadata, under the vehicle's facts, as "parameters".
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.vehicles.vehicle import CODE_LENGTH, described, read_tensors, tensor_of


@dataclass(frozen=True)
class BoxOfParameters:
    """The parameters of a vehicle that its kind leaves open, in units of the decoder's table.

    basis: (k, d) what one unit of each adds to the code. start, low, high: (k,) the vehicle's own and its kind's range.
    names: of the parameters.
    """

    basis: NDArray[np.float32]
    start: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    names: tuple[str, ...]


def parameter_tensors(name: str, box: BoxOfParameters) -> dict[str, NDArray[np.float32]]:
    """The tensors that `read_parameters` reads."""
    values = {"basis": box.basis, "start": box.start, "low": box.low, "high": box.high}
    return {f"{name}.parameters.{what}": np.asarray(value, np.float32) for what, value in values.items()}


def parametric_vehicles(path: Path) -> frozenset[str]:
    """The vehicles of a file whose codes are made of parameters. Raises InputError for an unreadable file."""
    _, metadata, source = read_tensors(path)
    facts = described(metadata, "baselines", source)
    return frozenset(name for name, fact in facts.items() if _names(fact) is not None)


def read_parameters(path: Path, name: str) -> BoxOfParameters:
    """The parameters of one vehicle of a file.

    Raises: InputError naming the file: it is unreadable, the vehicle unknown or made of no parameters, or a range is
        empty or does not hold the vehicle itself.
    """
    tensors, metadata, source = read_tensors(path)
    listed = _names(described(metadata, "baselines", source).get(name))
    if listed is None:
        remedy = "Give vehicle=wide, or attack.space=pca or free"
        raise InputError(f"{name[:80]!r} is made of no parameters", f"{source}, attack.space=parameters", remedy)
    names = tuple(str(parameter) for parameter in listed)
    basis = tensor_of(tensors, f"{name}.parameters.basis", (len(names), CODE_LENGTH), source)
    start, low, high = (
        tensor_of(tensors, f"{name}.parameters.{what}", (len(names),), source).astype(np.float64)
        for what in ("start", "low", "high")
    )
    wrong = [names[index] for index in np.flatnonzero(~((low < high) & (low <= start) & (start <= high)))]
    if wrong or not names:
        what = f"{name[:80]!r}: the range of {wrong[0] if wrong else 'no parameter'} does not hold the vehicle"
        raise InputError(what, str(source), "a vehicles file of shift3d")
    return BoxOfParameters(basis, start, low, high, names)


def _names(facts: Any) -> list[Any] | None:
    """The parameters that a vehicle's facts list; None for none."""
    listed = facts.get("parameters") if isinstance(facts, dict) else None
    return listed if isinstance(listed, list) else None
