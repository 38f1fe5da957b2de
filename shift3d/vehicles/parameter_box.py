"""Parameters behind a vehicle's latent code, with their ranges: tensors stored beside the vehicle's code.

Vehicle NAME has `NAME.parameters.basis` (k, code), `.start`, `.low` and `.high` (k,), float32. The parameters' names
are in the metadata, under "parameters" of the vehicle's entry.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.vehicles.vehicle import CODE_LENGTH, checked_tensor, described, read_tensors


@dataclass(frozen=True)
class ParameterBox:
    """Free parameters of a vehicle within its kind, in units of the decoder's table.

    basis: (k, d) change of the code per unit of each parameter. start, low, high: (k,) values of the vehicle, and the
    range of its kind. names: of the parameters.
    """

    basis: NDArray[np.float32]
    start: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    names: tuple[str, ...]


def kind_and_number(name: str) -> tuple[str, int]:
    """Split "camper-3", the third vehicle drawn of its kind, into ("camper", 3). A name without number gives 0."""
    found = re.fullmatch(r"(.+)-([1-9][0-9]{0,5})", name)
    return (found[1], int(found[2])) if found else (name, 0)


def random_box(kind: str, box: ParameterBox, number: int) -> ParameterBox:
    """Return a kind's box whose start is drawn vehicle `number`: each parameter is uniform over its range.

    Source: our choice, as in `attack.search=random`.
    """
    return replace(box, start=generator("drawn vehicle", kind, number).uniform(box.low, box.high))


def code_of_box(code: NDArray[np.float32], box: ParameterBox, drawn: ParameterBox) -> NDArray[np.float32]:
    """Return the code (d,) of a drawn vehicle. code: of the vehicle whose box is `box`."""
    # Sum row by row: a matrix product rounds differently on other processors, and the code enters a task's id.
    moved = ((drawn.start - box.start)[:, None] * box.basis).sum(axis=0)
    return np.asarray(code + moved, np.float32)


def parameter_tensors(name: str, box: ParameterBox) -> dict[str, NDArray[np.float32]]:
    """Return the tensors that `read_parameters` reads."""
    values = {"basis": box.basis, "start": box.start, "low": box.low, "high": box.high}
    return {f"{name}.parameters.{what}": np.asarray(value, np.float32) for what, value in values.items()}


def parametric_vehicles(path: Path) -> frozenset[str]:
    """Return the vehicles of a file that have parameters. Raises: InputError for an unreadable file."""
    _, metadata, source = read_tensors(path)
    facts = described(metadata, "baselines", source)
    return frozenset(name for name, fact in facts.items() if _names(fact) is not None)


def read_parameters(path: Path, name: str) -> ParameterBox:
    """Read the parameters of one vehicle of a file.

    Raises: InputError naming the file: it is unreadable, the vehicle is unknown or has no parameters, or a range is
        empty or excludes the vehicle itself.
    """
    tensors, metadata, source = read_tensors(path)
    listed = _names(described(metadata, "baselines", source).get(name))
    if listed is None:
        remedy = "Give vehicle=wide, or attack.space=pca or free"
        raise InputError(f"{name[:80]!r} is made of no parameters", f"{source}, attack.space=parameters", remedy)
    names = tuple(str(parameter) for parameter in listed)
    basis = checked_tensor(tensors, f"{name}.parameters.basis", (len(names), CODE_LENGTH), source)
    start, low, high = (
        checked_tensor(tensors, f"{name}.parameters.{what}", (len(names),), source).astype(np.float64)
        for what in ("start", "low", "high")
    )
    wrong = [names[index] for index in np.flatnonzero(~((low < high) & (low <= start) & (start <= high)))]
    if wrong or not names:
        what = f"{name[:80]!r}: the range of {wrong[0] if wrong else 'no parameter'} does not hold the vehicle"
        raise InputError(what, str(source), "Give a vehicles file of shift3d")
    return ParameterBox(basis, start, low, high, names)


def _names(facts: Any) -> list[Any] | None:
    """Return the parameter names in a vehicle's metadata entry; None without any."""
    listed = facts.get("parameters") if isinstance(facts, dict) else None
    return listed if isinstance(listed, list) else None
