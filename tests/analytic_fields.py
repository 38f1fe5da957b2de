"""Closed-form fields for tests, with the call signature of a decoder's field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from shift3d.sdf.field import Field as Network

Field = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Frame:
    """Vehicle frame. The default maps metres to sdf units one to one."""

    size_m: tuple[float, float, float] = (4.4, 1.8, 1.5)
    scale_m: float = 1.0
    sdf_R_object: np.ndarray = field(default_factory=lambda: np.eye(3))  # noqa: N815
    sdf_t_object: np.ndarray = field(default_factory=lambda: np.zeros(3))


# A frame like ShapeNet's: x width, y up, z length, off centre, 2.5 m per unit.
SHAPENET_FRAME = Frame(
    scale_m=2.5,
    sdf_R_object=np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    sdf_t_object=np.array([0.01, -0.02, 0.03]),
)


def in_frame(metric: Field, frame: Frame) -> Field:
    """Return the sdf-frame field of a shape that is given in the object frame and in metres."""
    rotation = torch.as_tensor(frame.sdf_R_object)
    shift = torch.as_tensor(frame.sdf_t_object)

    def g(x_sdf: Tensor) -> Tensor:
        x_object = (x_sdf - shift.to(x_sdf)) @ rotation.to(x_sdf) * frame.scale_m
        return metric(x_object) / frame.scale_m

    return g


def sphere(radius: float | Tensor = 1.0, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Field:
    return lambda x: (x - x.new_tensor(centre)).norm(dim=-1) - radius


def box(half: tuple[float, float, float], centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Field:
    def g(x: Tensor) -> Tensor:
        q = (x - x.new_tensor(centre)).abs() - x.new_tensor(half)
        return q.clamp_min(0.0).norm(dim=-1) + q.amax(-1).clamp_max(0.0)

    return g


def union(*fields: Field) -> Field:
    return lambda x: torch.stack([f(x) for f in fields]).amin(0)


def rounded(field: Field, radius: float) -> Field:
    return lambda x: field(x) - radius


def car() -> Field:
    """Return a car of body, cabin and four wheels: 4.4 x 1.8 x 1.5 m, edges rounded by 5 cm."""
    body = rounded(box((2.15, 0.85, 0.35), (0.0, 0.0, -0.15)), 0.05)
    cabin = rounded(box((1.0, 0.75, 0.3), (-0.2, 0.0, 0.4)), 0.05)
    wheels = [rounded(box((0.25, 0.08, 0.25), (1.3 * sx, 0.75 * sy, -0.45)), 0.05) for sx in (-1, 1) for sy in (-1, 1)]
    return union(body, cabin, *wheels)


def soft_car(code: Tensor) -> Field:
    """Return a smooth shape of a code (6,): ellipsoid semi-axes 2.0, 0.9, 0.7 changed by code[:3]; the rest ripples."""

    def g(x: Tensor) -> Tensor:
        c = code.to(x)
        axes = x.new_tensor([2.0, 0.9, 0.7]) * (1.0 + 0.2 * torch.tanh(c[:3]))
        ripple = 0.05 * (c[3:] * torch.sin(2.0 * x)).sum(-1)
        # |x / a| - 1 scaled by the smallest axis is less than the distance, so a march cannot step over the surface.
        return ((x / axes).norm(dim=-1) - 1.0) * 0.6 + ripple

    return g


def wall_with_a_bump(rise: float, narrow: float = 1.0, aside_m: float = 0.0) -> Network:
    """Return a ReLU network in float64: a wall at x = 0 and, as a unit of its own, a bump at (y, z) about 0.09 m.

    rise: height of the bump, sdf units; the unit is on nowhere if it is negative. narrow: steepness of the bump.
    """
    centre, eye = torch.tensor([0.0, 0.035 + aside_m / 2.5, 0.03], dtype=torch.float64), torch.eye(3).double()
    first, first_bias = torch.cat((eye, -eye)), torch.cat((-centre, centre))
    hidden, out = torch.zeros(64, 6, dtype=torch.float64), torch.zeros(1, 64, dtype=torch.float64)
    hidden[0, 0], hidden[0, 3] = -1.0, 1.0
    hidden[1, 0], hidden[1, 3] = 1.0, -1.0
    hidden[63] = -torch.tensor([1.0, narrow, narrow] * 2, dtype=torch.float64)
    out[0, 0], out[0, 1], out[0, 63] = 1.0, -1.0, -1.0
    bias = torch.zeros(64, dtype=torch.float64)
    bias[63] = rise
    return Network([first, hidden, out], [first_bias, bias, torch.zeros(1, dtype=torch.float64)], skip_layer=-1)


def ground_scan(
    rings: int = 48, columns: int = 720, height_m: float = 1.73, far_m: float = 60.0
) -> tuple[np.ndarray, np.ndarray]:
    """Scan flat ground and a wall of radius far_m with a spinning sensor. Returns float32 points and the origin."""
    elevation = np.deg2rad(np.linspace(-24.0, 2.0, rings))
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    direction = np.stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), -1).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        to_ground = np.where(direction[:, 2] < 0, -height_m / direction[:, 2], np.inf)
    k = np.minimum(to_ground, far_m / np.hypot(direction[:, 0], direction[:, 1]))
    return (direction * k[:, None]).astype(np.float32), np.zeros(3, np.float32)


def sector_scan(
    centre: tuple[float, float, float],
    half_angle_rad: float = 0.18,
    rays: int = 40,
    far_m: float = 40.0,
    dtype: type = np.float64,
) -> tuple[np.ndarray, np.ndarray]:
    """Make a square fan of beams from the origin about the direction of a centre, all returning from far_m."""
    axis = np.asarray(centre) / np.linalg.norm(centre)
    side = np.cross([0.0, 0.0, 1.0], axis)
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    u, w = np.meshgrid(np.linspace(-1, 1, rays), np.linspace(-1, 1, rays))
    direction = axis + np.tan(half_angle_rad) * (u[..., None] * side + 0.6 * w[..., None] * up)
    direction = direction.reshape(-1, 3)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return (far_m * direction).astype(dtype), np.zeros(3, dtype)
