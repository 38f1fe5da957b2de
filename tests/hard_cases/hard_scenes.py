"""Small scenes for the hard cases of rendering: a beam or a fan of beams, a closed-form shape, every solver."""

from __future__ import annotations

import math

import numpy as np
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, in_frame, sector_scan
from torch import Tensor

from shift3d.render import Beams, Rendering, RenderSettings, SdfGrid, preset, render
from shift3d.render.solvers.search import WarmStart
from shift3d.sdf.field import Field as Network
from shift3d.sdf.linear_regions import LinearRegion

FAST = preset("standard").with_(dtype=torch.float64)
REFERENCE = preset("reference").with_(step_m=0.01)
PAPER = preset("paper").with_(dtype=torch.float64)
PRESETS = {"standard": FAST, "reference": REFERENCE, "paper": PAPER}
FEW, MANY = 1, 40
"""Numbers of beams: up to 32 are marched several steps at a time (see `bracket`), more one step at a time."""
PLAIN = Frame(scale_m=2.5)
"""Object frame and sdf frame share axes and origin: coordinates pass without rounding."""


def pose(*values: float) -> Tensor:
    """Return (6,) x, y, z, yaw, pitch, roll, float64; missing values are 0."""
    return torch.tensor([*values, *[0.0] * (6 - len(values))], dtype=torch.float64)


AT_TEN = pose(10.0)


def beams_along_x(y: float = 0.0, start_x: float = 0.0, end_x: float = 30.0, z: float = 0.0, count: int = FEW) -> Beams:
    """Return the same beam in +x, `count` times."""
    return Beams.from_arrays(np.array([[end_x, y, z]] * count), np.array([start_x, y, z]))


def fan(theta: Tensor, rays: int = 20, half_angle_rad: float = 0.18, far_m: float = 40.0) -> Beams:
    """Return a square fan of beams from the origin towards an object's place."""
    x, y, z = theta[:3].tolist()
    return Beams.from_arrays(*sector_scan((x, y, z), half_angle_rad, rays, far_m))


def draw(
    beams: Beams,
    metric: Field,
    theta: Tensor = AT_TEN,
    settings: RenderSettings = FAST,
    warm: WarmStart | None = None,
    space: SdfGrid | None = None,
    frame: Frame = SHAPENET_FRAME,
) -> Rendering:
    """Render a shape that is given in the object frame and in metres."""
    return render(beams, in_frame(metric, frame), theta, frame, settings, warm, space)


def in_plain(metric: Field) -> Field:
    """Return a shape in the sdf units of the plain frame."""
    return in_frame(metric, PLAIN)


def sound(rendering: Rendering) -> None:
    """Check that no value of a rendering is NaN or infinite."""
    assert torch.isfinite(rendering.points).all() and torch.isfinite(rendering.range_m).all()
    assert math.isfinite(rendering.max_residual_m) and rendering.non_finite == 0


def hit_at(rendering: Rendering, range_m: float, tolerance_m: float = 1e-4) -> None:
    """Check that every beam hits at one range."""
    assert rendering.hit_mask.all() and rendering.unresolved_beams == 0
    assert float((rendering.range_m.detach() - range_m).abs().max()) <= tolerance_m, rendering.range_m.tolist()


def unmoved(rendering: Rendering, beams: Beams, unresolved: int = 0) -> None:
    """Check that no beam hits, `unresolved` of them are counted, and every return is unchanged, bit for bit."""
    assert not rendering.hit_mask.any() and rendering.unresolved_beams == unresolved
    assert torch.equal(rendering.points, beams.points)


def at_most(metric: Field, calls: int) -> Field:
    """Return the field, which raises after this many calls: an endless search differs from a slow one."""
    spent = 0

    def g(x: Tensor) -> Tensor:
        nonlocal spent
        spent += 1
        assert spent <= calls, "a search that does not end"
        return metric(x)

    return g


class BentLine(Network):
    """ReLU network of x_sdf alone: tanh of a line that bends at each (place, change of slope), and is `level` before.

    Raises after 500 calls, because an endless traversal would take 200,000.
    """

    def __init__(self, level: float, bends: list[tuple[float, float]]) -> None:
        first = torch.zeros(len(bends), 3, dtype=torch.float64)
        first[:, 0] = 1.0
        starts = torch.tensor([where for where, _ in bends], dtype=torch.float64)
        last = torch.tensor([[change for _, change in bends]], dtype=torch.float64)
        super().__init__([first, last], [-starts, torch.tensor([level], dtype=torch.float64)], -1)
        self.calls = 0

    def __call__(self, x_sdf: Tensor) -> Tensor:
        self._count()
        return super().__call__(x_sdf)

    def region(self, x_sdf: Tensor, direction: Tensor) -> LinearRegion:
        """Return the linear region, like any network, and count the call."""
        self._count()
        return super().region(x_sdf, direction)

    def _count(self) -> None:
        self.calls += 1
        assert self.calls <= 500, "a traversal that does not end"
