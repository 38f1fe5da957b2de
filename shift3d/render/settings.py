"""Settings of the renderer: one named setting for each approximation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch

from shift3d.errors import InputError

SMALLEST_SCALE_M = 0.5
"""Settings alone are checked for an object a metre long; `render` checks them again for the actual vehicle."""

LEAST_STEP_M = 1e-5
"""Shortest `step_m` (our choice): below it, the search between two samples takes hours."""

_POSITIVE = (
    *("step_m", "max_step_m", "step_safety", "max_slope", "tolerance_m", "max_iterations"),
    *("approach_slope", "grazing_m", "batch"),
)
_NOT_NEGATIVE = (
    *("final_newton_m", "box_margin_m", "min_n_dot_d", "bfloat16_band_m", "warm_refresh", "approach_m"),
    *("warm_change_m", "prediction_error"),
)

Solver = Literal["paper", "plain_sphere_tracing", "sphere_tracing", "piecewise_linear"]


def reachable_residual_m(dtype: torch.dtype, scale_m: float, range_m: float = 100.0) -> float:
    """Compute the metric |g|, m, below which a root in a dtype is meaningless: the change of g by rounding.

    Args:
        dtype: of the field's evaluation. scale_m: metres per sdf unit. range_m: distance of the object from its sensor.

    A position in the unit ball is rounded: each coordinate x_i is off by up to u |x_i|, u = eps / 2, which changes the
    distance by u |x| <= u, in sdf units. The decoder's own sums are allowed twice that: for the shipped decoder they
    add at most 0.6 u with MKL and 1.2 u with oneDNN (measured on its surface; tests/precision checks this limit). The
    total is 3 u times scale_m. The range along the beam is float64 in every dtype, and is rounded as well: by eps64
    range_m / 2 on either side.

    For a car the result is 5e-7 m in float32. The paper's |g| < 1e-6 can be reached because positions are relative to
    the object's own centre; float32 positions relative to the sensor could not reach it (eps32 times 40 m is 5e-6). In
    float64 the result is 2e-14 m.
    Source: our choice: the paper is silent on precision.
    """
    return 1.5 * torch.finfo(dtype).eps * scale_m + torch.finfo(torch.float64).eps * range_m


@dataclass(frozen=True)
class RenderSettings:
    """Approximations by which the renderer trades accuracy for time.

    Attributes:
        solver: `sphere_tracing` predicts, corrects and refines, see `search`. `plain_sphere_tracing` is its simple
            reference, see `sphere_tracing.first_hits`. `paper` samples every beam through the 7 m sphere and bisects.
            `piecewise_linear` traverses the linear regions of a ReLU decoder and misses no first crossing if
            `max_slope` holds (for any other field `sphere_tracing` is used).
        dtype: precision of the field's evaluation. Beam geometry is always float64.
        step_m: `paper`: sample spacing. Sphere tracing: the least step, and the length of an interval that may stay
            uncovered.
        max_step_m: sphere tracing: the largest step; a learned field says little about far distances.
        step_safety: sphere tracing: share of the field's distance that counts as free. Below 1 because a learned field
            can be steeper than a true distance.
        max_slope: `piecewise_linear`: assumed upper bound of |grad g| far from the surface; infinite: no bound is
            assumed, every region is traversed. The steepest place of the shipped decoder found in 54,000 points of nine
            shapes, attacked ones among them, has 1.7.
        tolerance_m: metric |g| at which a root counts as found. Not below what the dtype can reach, see
            `reachable_residual_m`. The paper asks for 1e-6, but ends after 30 bisections whatever |g| then is; the
            solver `paper` does the same and ignores this setting.
        final_newton_m: final Newton threshold: a last step of at most this length is not evaluated if a gradient is
            taken afterwards, which linearizes the field at the root anyway; 0: every root is evaluated.
        max_iterations: bisections (`paper`) or root iterations.
        box_margin_m: growth of the vehicle's box before beams are culled against it.
        sphere_chord_only: `paper`: sample only the part of a beam inside the 7 m sphere. The paper samples the whole
            beam; outside the sphere g is positive, so this changes no hit as long as the field is a distance there. The
            sample positions are those of the whole beam.
        warm_start: start from the previous rendering if one is given.
        warm_refresh: number of warm renderings in a row before a full search.
        warm_change_m: a full search is made if the field's change since the earlier rendering differs by more than this
            within a cell of the change grid (0.45 m).
        prediction_error: error bound of a predicted sample, as a share of that difference and of the sample's motion.
        local_minima: also sample intervals that leave at most `step_m` uncovered, next to local minima and where g
            hardly falls. False: a chord shorter than `step_m` may be missed.
        approach_slope, approach_m: the approach to a hit is clear if g falls by this slope or more over at most this
            length; a clear approach is not searched for other crossings.
        grazing_m: an interval that g crosses at a flatter slope than `approach_slope` is halved down to this width,
            because it may hold several crossings.
        sdf_grid: use an SDF grid of the field if one is given (`SdfGrid`).
        live_units: leave out the decoder's hidden units that are off at all places of a survey: the vehicle's box, and
            every hit.
        bfloat16_band_m: farther than this from the surface a decoder is evaluated in bfloat16 if the value only sets
            the length of a step; 0: never.
        min_n_dot_d: smallest |grad g . d| by which a gradient is divided, d the beam's direction; see `implicit`.
        batch: points per call of the field.
    """

    solver: Solver = "sphere_tracing"
    dtype: torch.dtype = torch.float32
    step_m: float = 0.02
    max_step_m: float = 0.25
    step_safety: float = 0.9
    max_slope: float = 3.0
    tolerance_m: float = 3e-6
    final_newton_m: float = 1e-5
    max_iterations: int = 60
    box_margin_m: float = 0.1
    sphere_chord_only: bool = False
    warm_start: bool = True
    warm_refresh: int = 40
    warm_change_m: float = 0.2
    prediction_error: float = 0.5
    local_minima: bool = True
    approach_slope: float = 0.3
    approach_m: float = 0.2
    grazing_m: float = 0.003
    sdf_grid: bool = True
    live_units: bool = True
    bfloat16_band_m: float = 0.02
    min_n_dot_d: float = 0.2
    batch: int = 256

    def __post_init__(self) -> None:
        if self.solver not in get_args(Solver):
            found = f"solver is {self.solver!r}"
            raise InputError(found, where="render settings", remedy=f"Choose from {', '.join(get_args(Solver))}")
        for name in _POSITIVE + _NOT_NEGATIVE:
            # Comparisons with NaN are false: a margin of NaN would drop every beam silently.
            value, must = getattr(self, name), "be positive" if name in _POSITIVE else "not be negative"
            if not (value > 0 if name in _POSITIVE else value >= 0):
                raise InputError(f"{name} must {must}", where=f"render settings: {name}={value}")
        if self.step_m < LEAST_STEP_M:
            found = f"step_m is {self.step_m} m, and a beam is up to 100 m long"
            raise InputError(found, where="render settings", remedy=f"Give step_m={LEAST_STEP_M:g} or more")
        if not self.dtype.is_floating_point:
            raise InputError(f"dtype is {self.dtype}", where="render settings", remedy="Give float32 or float64")
        self.check_tolerance(SMALLEST_SCALE_M)

    def reachable_residual_m(self, scale_m: float, range_m: float = 100.0) -> float:
        """Compute `reachable_residual_m` for the dtype of these settings."""
        return reachable_residual_m(self.dtype, scale_m, range_m)

    def check_tolerance(self, scale_m: float) -> None:
        """Refuse a tolerance that the dtype cannot reach on an object of this scale, if the solver uses the tolerance.

        Raises: InputError: states the reachable tolerance, and the setting that allows a smaller one.
        """
        reachable = self.reachable_residual_m(scale_m)
        if self.solver == "paper" or self.tolerance_m >= reachable:
            return
        dtype = str(self.dtype).removeprefix("torch.")
        finer = "" if self.dtype == torch.float64 else ", or dtype=float64"
        raise InputError(
            f"|g| <= {self.tolerance_m:g} m cannot be reached in {dtype}, whose rounding alone is {reachable:.1e} m",
            where=f"render settings: tolerance_m={self.tolerance_m:g}",
            remedy=f"Give tolerance_m={reachable:.1e} or more{finer}",
        )

    def with_(self, **changes: object) -> RenderSettings:
        """Return the settings with some of them replaced."""
        return replace(self, **changes)  # type: ignore[arg-type]


PAPER = RenderSettings(
    solver="paper",
    step_m=0.1,
    tolerance_m=1e-6,
    final_newton_m=0.0,
    max_iterations=30,
    min_n_dot_d=0.0,
    warm_start=False,
    sdf_grid=False,
    live_units=False,
    bfloat16_band_m=0.0,
    batch=16384,
)
STANDARD = RenderSettings()
DRAFT = RenderSettings(
    step_m=0.03, step_safety=1.0, tolerance_m=1e-3, final_newton_m=5e-3, local_minima=False, bfloat16_band_m=0.005
)
# min_n_dot_d is the standard value: it defines the gradient for descent and is no approximation; with the paper's 0 a
# handful of grazing beams would decide every comparison of gradients. Only fields that are not piecewise linear use
# step_m to tolerance_m.
REFERENCE = RenderSettings(
    solver="piecewise_linear",
    dtype=torch.float64,
    step_m=0.005,
    max_step_m=0.05,
    step_safety=0.5,
    tolerance_m=1e-9,
    final_newton_m=0.0,
    max_iterations=80,
    box_margin_m=0.3,
    warm_start=False,
    sdf_grid=False,
    live_units=False,
    bfloat16_band_m=0.0,
)
PRESETS: dict[str, RenderSettings] = {
    "draft": DRAFT,
    "standard": STANDARD,
    "paper": PAPER,
    "reference": REFERENCE,
}


def preset(name: str) -> RenderSettings:
    """Return the settings of a preset. Raises InputError for an unknown name."""
    if name not in PRESETS:
        raise InputError(
            f"unknown accuracy preset {name!r}",
            where="render settings",
            remedy=f"Choose from {', '.join(PRESETS)}",
        )
    return PRESETS[name]
