"""Settings of the renderer that had another name or are gone: refused with the new name, read from older folders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shift3d.errors import InputError

__all__ = ["current_settings", "renamed_error"]

_NAMES = {
    "unchecked_m": "final_newton_m",
    "coarse_band_m": "bfloat16_band_m",
    "grazing_floor": "min_n_dot_d",
    "look_between": "local_minima",
    "empty_space": "sdf_grid",
}
_SOLVERS = {"hybrid": "sphere_tracing", "exact": "piecewise_linear"}
_GONE = {
    "root": "there is one root finder",
    "warm_gap_m": "a warm rendering covers its rays as a cold one does, to step_m",
}
_GONE_SOLVERS = {"march": "plain_sphere_tracing takes steps of at least step_m, paper samples every step_m"}
_WHERE = "accuracy.render"


def renamed_error(name: str, value: Any = None) -> InputError | None:
    """The error for an older setting of ``accuracy.render``, or for an older solver; None for any other setting."""
    key = f"{_WHERE}.{name}"
    if name in _NAMES:
        return InputError(f"{key} is called {_NAMES[name]}", remedy=f"Write {_WHERE}.{_NAMES[name]}=VALUE")
    if name in _GONE:
        return InputError(f"{key} is gone: {_GONE[name]}", remedy="Leave it out")
    if name == "solver" and value in _SOLVERS:
        return InputError(f"{key}={value} is called {_SOLVERS[value]}", remedy=f"Write {key}={_SOLVERS[value]}")
    if name == "solver" and value in _GONE_SOLVERS:
        return InputError(f"{key}={value} is gone: {_GONE_SOLVERS[value]}", remedy="Choose one of them")
    return None


def current_settings(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A task's settings, of this or an older program, by today's names.

    Raises:
        InputError: a solver that is gone.
    """
    found = {_NAMES.get(name, name): value for name, value in values.items() if name not in _GONE}
    solver = found.get("solver")
    if solver in _GONE_SOLVERS:
        remedy = "Use the version of shift3d that began the sweep"
        raise InputError(f"the renderer has no solver {solver!r} any more", where, remedy)
    return found | ({"solver": _SOLVERS[solver]} if solver in _SOLVERS else {})
