"""Every approximation of the renderer, as a named setting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch

from shift3d.errors import InputError

SMALLEST_SCALE_M = 0.5
"""Settings alone are checked for an object a metre long; `render` checks them again for the one at hand."""

Solver = Literal["paper", "hybrid", "exact", "march"]
Root = Literal["anderson_bjorck", "itp", "bisection"]


def reachable_residual_m(dtype: torch.dtype, scale_m: float, range_m: float = 100.0) -> float:
    """The metric |g|, m, below which a root found in a dtype means nothing: what its rounding moves g by.

    Args:
        dtype: in which the field is evaluated. scale_m: metres per sdf unit. range_m: of the object from its sensor.

    A place in the unit ball is a rounded one: each coordinate x_i is off by up to u |x_i|, u = eps / 2, which moves a
    distance by u |x| <= u, in sdf units. The decoder's own sums are granted twice that: those of the shipped one add
    0.6 u at most by MKL, 1.2 u by oneDNN (measured on its surface; tests/precision holds it to that). Together 3 u,
    times scale_m.
    The range along the beam is float64 whatever the dtype, and rounded as well: by eps64 range_m / 2 on either side.

    For a car, 5e-7 m in float32: the paper's |g| < 1e-6 is reached there because places are told from the object's
    own centre; from the sensor, in float32, it is not (eps32 times 40 m is 5e-6). 2e-14 m in float64.
    Source: our choice: the paper is silent on precision.
    """
    return 1.5 * torch.finfo(dtype).eps * scale_m + torch.finfo(torch.float64).eps * range_m


@dataclass(frozen=True)
class RenderSettings:
    """What the renderer may trade for time.

    Attributes:
        solver: `paper` samples every beam through the 7 m sphere and bisects; `hybrid` culls to the
            vehicle's box, marches by the field's own distance and finds roots with a safeguarded secant; `exact`
            walks the linear pieces of a ReLU decoder and misses no first crossing where `max_slope` holds (see there;
            for any other field it is `hybrid`); `march` is the paper's search inside the vehicle's box.
        root: `hybrid`: how the root in a bracket is found, see `roots` and `itp`.
        dtype: precision in which the field is evaluated. Beam geometry is float64 whatever this says.
        step_m: `paper`, `march`: largest sample spacing. `hybrid`: the smallest march step, that is the chord
            that is hard to miss.
        max_step_m: `hybrid`: the largest march step; a learned field says little about far distances.
        step_safety: `hybrid`: share of the field's distance that one step may cover. Below 1 because a
            learned field can be steeper than a true distance.
        max_slope: `exact`: what |grad g| is taken never to exceed where the surface is far; infinite: nothing is
            taken, every piece is walked. The steepest place of the shipped decoder that was found in 54,000 points
            of nine shapes, attacked ones among them, had 1.7.
        tolerance_m: metric |g| at which a root counts as found (`hybrid`, and `exact` for fields that have no linear
            pieces). Not below what the dtype can reach, see `reachable_residual_m`. The paper asks for 1e-6 and ends
            after 30 bisections whatever |g| then is, and so do `paper` and `march`, which do not look at it.
        unchecked_m: a last secant step of at most this length is not evaluated where a gradient is taken afterwards,
            which evaluates the root anyway and takes one more Newton step from it; 0: every root is evaluated.
        max_iterations: bisections (`paper`, `march`) or root iterations (`hybrid`).
        box_margin_m: growth of the vehicle's box before beams are culled against it.
        sphere_chord_only: `paper`: sample only the part of a beam inside the 7 m sphere. The paper
            samples the whole beam; outside the sphere g is positive, so this changes no hit as long as
            the field is a distance there. The sample positions are those of the whole beam.
        warm_start: start from the previous rendering where one is given.
        warm_refresh: warm renderings in a row before everything is searched afresh.
        warm_gap_m: how much more than `step_m` of a beam may lie between two spheres of free space where these are
            expected, from samples of an earlier rendering, and not measured. Of 259,534 hits in three attacks
            0.1 loses or misplaces 19, 0.03 fourteen, for 6 % more evaluations; of 3,024 in `make frontier` 0.3
            three, 0.1 and 0.03 one, 0 none, for 14 % and 4 % fewer and 8 % more evaluations than 0.03.
        look_between: `hybrid`: follow dips between two samples to their bottom, and look through brackets that are
            crossed at a flat angle. False: a chord shorter than a step may be missed.
        empty_space: use a map of empty space where one is handed over (`EmptySpace`).
        coarse_band_m: a decoder is evaluated in bfloat16 where it is farther than this from the surface, as far
            as that only sets the length of a step; 0 switches it off.
        grazing_floor: smallest |e . grad g| by which a gradient is divided, see `implicit`.
        batch: points handed to the field at once.
    """

    solver: Solver = "hybrid"
    root: Root = "anderson_bjorck"
    dtype: torch.dtype = torch.float32
    step_m: float = 0.02
    max_step_m: float = 0.25
    step_safety: float = 0.9
    max_slope: float = 3.0
    tolerance_m: float = 3e-6
    unchecked_m: float = 1e-3
    max_iterations: int = 40
    box_margin_m: float = 0.05
    sphere_chord_only: bool = False
    warm_start: bool = True
    warm_refresh: int = 40
    warm_gap_m: float = 0.03
    look_between: bool = True
    empty_space: bool = True
    coarse_band_m: float = 0.02
    grazing_floor: float = 0.2
    batch: int = 4096

    def __post_init__(self) -> None:
        for name, known in (("solver", get_args(Solver)), ("root", get_args(Root))):
            if getattr(self, name) not in known:
                found = f"{name} is {getattr(self, name)!r}"
                raise InputError(found, where="render settings", remedy=f"one of {', '.join(known)}")
        positive = ("step_m", "max_step_m", "step_safety", "max_slope", "tolerance_m", "max_iterations", "batch")
        for name in positive:
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive", where=f"render settings: {name}={getattr(self, name)}")
        not_negative = ("unchecked_m", "box_margin_m", "grazing_floor", "coarse_band_m", "warm_refresh", "warm_gap_m")
        for name in not_negative:
            # NaN compares false: a margin of NaN would leave no beam and say nothing.
            if not getattr(self, name) >= 0:
                found = f"{name} must not be negative"
                raise InputError(found, where=f"render settings: {name}={getattr(self, name)}")
        if not self.dtype.is_floating_point:
            raise InputError(f"dtype is {self.dtype}", where="render settings", remedy="float32 or float64")
        self.check_tolerance(SMALLEST_SCALE_M)

    def reachable_residual_m(self, scale_m: float, range_m: float = 100.0) -> float:
        """`reachable_residual_m` of these settings' dtype."""
        return reachable_residual_m(self.dtype, scale_m, range_m)

    def check_tolerance(self, scale_m: float) -> None:
        """Refuse a tolerance that the dtype cannot reach on an object of this scale, where the solver looks at it.

        Raises:
            InputError: saying what can be reached, and with which setting more.
        """
        reachable = self.reachable_residual_m(scale_m)
        if self.solver in ("paper", "march") or self.tolerance_m >= reachable:
            return
        dtype = str(self.dtype).removeprefix("torch.")
        finer = "" if self.dtype == torch.float64 else ", or dtype=float64"
        raise InputError(
            f"|g| <= {self.tolerance_m:g} m cannot be reached in {dtype}, whose rounding alone is {reachable:.1e} m",
            where=f"render settings: tolerance_m={self.tolerance_m:g}",
            remedy=f"tolerance_m of {reachable:.1e} or more{finer}",
        )

    def with_(self, **changes: object) -> RenderSettings:
        """The same settings with some of them replaced."""
        return replace(self, **changes)  # type: ignore[arg-type]


PAPER = RenderSettings(
    solver="paper",
    step_m=0.1,
    tolerance_m=1e-6,
    unchecked_m=0.0,
    max_iterations=30,
    grazing_floor=0.0,
    warm_start=False,
    empty_space=False,
    coarse_band_m=0.0,
    batch=16384,
)
STANDARD = RenderSettings()
# What saves most is not to look between samples: longer steps alone save nothing, since between samples that are 10 cm
# apart there is more to look into than steps were saved.
DRAFT = RenderSettings(
    step_m=0.03, step_safety=1.0, tolerance_m=1e-3, warm_gap_m=0.1, look_between=False, coarse_band_m=0.005
)
# The floor of the gradient is the standard one: it is a rule of what is descended, not an approximation, and with the
# paper's (none) a handful of grazing beams would decide every comparison of gradients. step_m to tolerance_m are for
# fields that are not piecewise linear.
REFERENCE = RenderSettings(
    solver="exact",
    dtype=torch.float64,
    step_m=0.005,
    max_step_m=0.05,
    step_safety=0.5,
    tolerance_m=1e-9,
    unchecked_m=0.0,
    max_iterations=80,
    box_margin_m=0.3,
    warm_start=False,
    empty_space=False,
    coarse_band_m=0.0,
)
PRESETS: dict[str, RenderSettings] = {
    "draft": DRAFT,
    "standard": STANDARD,
    "paper": PAPER,
    "reference": REFERENCE,
}


def preset(name: str) -> RenderSettings:
    """Settings by name.

    Raises:
        InputError: unknown name.
    """
    if name not in PRESETS:
        raise InputError(
            f"unknown accuracy preset {name!r}",
            where="render settings",
            remedy=f"one of {', '.join(PRESETS)}",
        )
    return PRESETS[name]
