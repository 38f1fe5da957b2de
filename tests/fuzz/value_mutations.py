"""Damage to plain values (JSON, YAML) and to arrays, drawn from a seed as in `mutations`."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from mutations import SPECIAL_FLOATS, Array, Rng, pick

# --- plain values

ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2.5, 10**12, -(10**30), 1e308, float("nan"), float("inf"), 1e-320, "", "abc"),
    *("???", "${a}", "nan", "1", [], [1], {}, {"a": 1}, [[[]]], {"_target_": "os.system"}, "x" * 500, "\n"),
)


def _places(values: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = values.keys() if isinstance(values, dict) else range(len(values)) if isinstance(values, list) else ()
    found = [path] if path else []
    for key in keys:
        found += _places(values[key], (*path, key))
    return found


def mutate_values(values: Any, rng: Rng) -> Any:
    """Copy nested dictionaries and lists with one value replaced, removed, renamed, doubled or moved."""
    values = copy.deepcopy(values)
    places = _places(values)
    if not places or rng.uniform() < 0.02:
        return copy.deepcopy(pick(ODD_VALUES, rng))
    *parents, leaf = pick(places, rng)
    parent = values
    for key in parents:
        parent = parent[key]
    _change_one(parent, leaf, values, places, rng)
    return values


def _change_one(parent: Any, leaf: Any, values: Any, places: list[tuple[Any, ...]], rng: Rng) -> None:
    action = pick(("replace", "replace", "replace", "remove", "rename", "number", "copy"), rng)
    number = isinstance(parent[leaf], int | float) and not isinstance(parent[leaf], bool)
    if action == "number" and number:
        parent[leaf] = parent[leaf] * float(pick((-1, 0, 1e-6, 1.5, 1000, 1e30), rng))
    elif action == "remove":
        del parent[leaf]
    elif action == "rename" and isinstance(parent, dict):
        parent[str(pick((f"{leaf}_", "_target_", "", "a.b", str(leaf).upper()), rng))] = parent.pop(leaf)
    elif action == "copy":
        value = values
        for key in pick(places, rng):
            value = value[key]
        parent[leaf] = copy.deepcopy(value)
    else:
        parent[leaf] = copy.deepcopy(pick(ODD_VALUES, rng))


# --- arrays

DTYPES = ("float16", "float64", "int64", "int32", "uint8", "bool", "complex64")


def write_specials(array: Array, rng: Rng) -> Array:
    """Set one to many entries to NaN, infinite, huge, tiny, zero or negative."""
    array = np.array(array)
    if not array.size:
        return array
    count = int(pick((1, 1, 1, 5, array.size), rng))
    at = rng.integers(array.size, size=min(count, 100_000))
    with np.errstate(over="ignore", invalid="ignore"):
        array.reshape(-1)[at] = np.array(pick(SPECIAL_FLOATS, rng)).astype(array.dtype)
    return array


def change_dtype(array: Array, rng: Rng) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(pick(DTYPES, rng))


def change_shape(array: Array, rng: Rng) -> Array:
    if not array.ndim:
        return array[None]
    how = pick(("transpose", "flatten", "drop", "double", "axis", "empty", "scalar"), rng)
    if how == "transpose":
        return array.T
    if how == "flatten":
        return array.reshape(-1)
    if how == "axis":
        return array[..., None]
    if how == "empty":
        return array[:0]
    if how == "scalar":
        return np.asarray(array.reshape(-1)[:1].sum(), array.dtype)
    return array[1:] if how == "drop" else np.concatenate([array, array])


def scramble(array: Array, rng: Rng) -> Array:
    """Reorder or scale rows or entries: the numbers stay finite."""
    if array.ndim and rng.uniform() < 0.5:
        return rng.permutation(array)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(array * float(pick((0.0, -1.0, 1e3, 1e-20, 1e12), rng)), array.dtype)


ARRAYS: tuple[Callable[[Array, Rng], Array], ...] = (
    *(write_specials, write_specials, change_dtype, change_shape, scramble),
)


def mutate_arrays(arrays: dict[str, Array], rng: Rng) -> dict[str, Array]:
    """Change one of the named arrays: changed, removed, renamed, doubled under a new name, or two swapped."""
    arrays = dict(arrays)
    name = str(pick(sorted(arrays), rng))
    action = pick(("change", "change", "change", "change", "remove", "rename", "add", "swap"), rng)
    if action == "remove":
        del arrays[name]
    elif action == "rename":
        arrays[f"{name}_old"] = arrays.pop(name)
    elif action == "add":
        arrays[f"module.{name}"] = arrays[name]
    elif action == "swap":
        other = str(pick(sorted(arrays), rng))
        arrays[name], arrays[other] = arrays[other], arrays[name]
    else:
        arrays[name] = pick(ARRAYS, rng)(arrays[name], rng)
    return arrays
