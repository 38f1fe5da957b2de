"""Older names of settings: refused on the command line with the valid name, accepted in older sweep folders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shift3d.errors import InputError

_RENDER = "accuracy.render."
_NAMES = {
    "accuracy.render.unchecked_m": "accuracy.render.final_newton_m",
    "accuracy.render.coarse_band_m": "accuracy.render.bfloat16_band_m",
    "accuracy.render.grazing_floor": "accuracy.render.min_n_dot_d",
    "accuracy.render.look_between": "accuracy.render.local_minima",
    "accuracy.render.empty_space": "accuracy.render.sdf_grid",
    "attack.steady_steps": "attack.selection_window",
}
_GONE = {
    "accuracy.render.root": "there is one root finder",
    "accuracy.render.warm_gap_m": "a warm rendering covers its rays as a cold one does, to step_m",
    "attack.sphere_m": "the radius of the sphere is the paper's, 7 m",
}
_VALUES = {
    ("accuracy.render.solver", "hybrid"): "sphere_tracing",
    ("accuracy.render.solver", "exact"): "piecewise_linear",
    ("effects", "silent_beams"): "no_return_beams",
}
_GONE_VALUES = {
    ("accuracy.render.solver", "march"): (
        "plain_sphere_tracing takes steps of at least step_m, paper samples every step_m"
    ),
}


def renamed_error(key: str, value: Any = None) -> InputError | None:
    """Return the error for an older setting, by its full name, or for an older value; None for all others."""
    if key in _NAMES:
        return InputError(f"{key} is called {_NAMES[key].rpartition('.')[2]}", remedy=f"Write {_NAMES[key]}=VALUE")
    if key in _GONE:
        return InputError(f"{key} is gone: {_GONE[key]}", remedy="Leave it out")
    if isinstance(value, str) and (key, value) in _VALUES:
        new = _VALUES[key, value]
        return InputError(f"{key}={value} is called {new}", remedy=f"Write {key}={new}")
    if isinstance(value, str) and (key, value) in _GONE_VALUES:
        return InputError(f"{key}={value} is gone: {_GONE_VALUES[key, value]}", remedy="Choose one of them")
    return None


def current_settings(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Convert stored renderer settings of any version to the valid names. Raises: InputError: a removed solver."""
    found = {
        _NAMES.get(_RENDER + name, _RENDER + name).removeprefix(_RENDER): value
        for name, value in values.items()
        if _RENDER + name not in _GONE
    }
    solver = (f"{_RENDER}solver", found.get("solver"))
    if solver in _GONE_VALUES:
        remedy = "Use the version of shift3d that began the sweep"
        raise InputError(f"the renderer has no solver {solver[1]!r} any more", where, remedy)
    return found | ({"solver": _VALUES[solver]} if solver in _VALUES else {})
