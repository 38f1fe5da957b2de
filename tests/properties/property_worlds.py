"""Parts of all property tests: few fixed examples, motions, scans, shapes, and the bounds of float64 geometry."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from analytic_fields import SHAPENET_FRAME, Frame, in_frame, soft_car
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene, scene_R_object
from shift3d.render import Beams, Field, Rendering, RenderSettings, preset, render
from shift3d.sdf.decoder import Architecture, Decoder

U64 = torch.finfo(torch.float64).eps / 2
EXACT = preset("standard").with_(dtype=torch.float64, tolerance_m=1e-12, final_newton_m=0.0, max_iterations=100)
"""The fast renderer with roots at float64's accuracy."""
FAST64 = preset("standard").with_(dtype=torch.float64, final_newton_m=0.0)
FARTHEST_M = 20_000.0
ANGLES = st.floats(-math.pi, math.pi)
NUMBERS = st.integers(0, 2**32 - 1)


def few(count: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Use the same `count` examples in every run: a failure repeats.

    A failure is shown without shrinking, which would take minutes of renderings.
    """
    return settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=[HealthCheck.function_scoped_fixture],
    )


def poses() -> st.SearchStrategy[Tensor]:
    """Draw objects 12 to 16 m in front of the sensor, in any attitude."""
    place = st.tuples(st.floats(12.0, 16.0), st.floats(-0.8, 0.8), st.floats(-0.9, 0.1))
    return st.tuples(place, st.tuples(ANGLES, ANGLES, ANGLES)).map(
        lambda parts: torch.tensor([*parts[0], *parts[1]], dtype=torch.float64)
    )


def soft_cars() -> st.SearchStrategy[Field]:
    """Draw smooth shapes by their six numbers."""
    return st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(
        lambda code: in_frame(soft_car(torch.tensor(code, dtype=torch.float64)), SHAPENET_FRAME)
    )


def shifts() -> st.SearchStrategy[Tensor]:
    """Draw moves (3,) of a whole scene, at most 20 km along each axis, of any order of magnitude."""

    def shift(number: int) -> Tensor:
        rng = np.random.default_rng(number)
        return torch.from_numpy(
            rng.choice([-1.0, 1.0], 3) * FARTHEST_M * 10.0 ** -rng.uniform(0.0, rng.choice([0.1, 5.0]), 3)
        )

    return NUMBERS.map(shift)


def rotations() -> st.SearchStrategy[Tensor]:
    """Draw rotations (3, 3) about any axis, from unit quaternions."""
    return NUMBERS.map(_rotation)


def _rotation(number: int) -> Tensor:
    w, x, y, z = np.random.default_rng(number).normal(size=4)
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64)


def moved_pose(theta: Tensor, rotation: Tensor, shift_m: Tensor) -> Tensor:
    """Return the pose of an object that moved rigidly with the whole scene.

    Yaw comes first, roll from the remaining rotation: at a pitch of 90 degrees, where neither is determined, both
    together still make the same rotation.
    """
    turned = rotation @ scene_R_object(theta)
    yaw = math.atan2(float(turned[1, 0]), float(turned[0, 0]))
    pitch = math.atan2(-float(turned[2, 0]), math.hypot(float(turned[0, 0]), float(turned[1, 0])))
    about_z = torch.tensor([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]], dtype=torch.float64)
    side = about_z @ turned[:2, 1:]
    roll = math.atan2(-float(side[1, 1]), float(side[1, 0]))
    return torch.cat((rotation @ theta[:3] + shift_m, torch.tensor([yaw, pitch, roll], dtype=torch.float64)))


def fan(rays: int = 16, far_m: float = 40.0, seed: int = 0) -> np.ndarray:
    """Return (rays^2, 3) returns of a sensor at the origin, spread evenly about `poses`, with fixed jitter."""
    rng = np.random.default_rng(seed)
    y, z = np.meshgrid(np.linspace(-0.2, 0.2, rays), np.linspace(-0.15, 0.09, rays))
    ends = np.stack((np.ones(rays * rays), y.ravel(), z.ravel()), -1)
    ends[:, 1:] += rng.uniform(-0.003, 0.003, (rays * rays, 2))
    return far_m * ends / np.linalg.norm(ends, axis=1, keepdims=True)


def draw(
    beams: Beams, field: Field, theta: Tensor, settings: RenderSettings = EXACT, frame: Frame = SHAPENET_FRAME
) -> Rendering:
    return render(beams, field, theta, frame, settings)


def slopes(rendering: Rendering, beams: Beams, field: Field, theta: Tensor, frame: Frame = SHAPENET_FRAME) -> Tensor:
    """Return (H,) |e . grad g| at the hits, metric: the change of g per metre of range."""
    rows = rendering.hit_mask
    place = beams.origins[rows] + rendering.range_m[rows, None] * beams.directions[rows]
    x_object = object_from_scene(place, theta).requires_grad_()
    x_sdf = x_object @ torch.as_tensor(frame.sdf_R_object).T / frame.scale_m + torch.as_tensor(frame.sdf_t_object)
    (gradient,) = torch.autograd.grad((field(x_sdf) * frame.scale_m).sum(), x_object)
    return (gradient * (beams.directions[rows] @ scene_R_object(theta))).sum(-1).abs()


def known_to_m(slope: Tensor, range_m: Tensor, tolerance_m: float = EXACT.tolerance_m) -> Tensor:
    """Bound the error of a root's range: |g| within the tolerance, or its bracket shrunk to 1e-12 (see `roots`)."""
    return tolerance_m / slope + 1e-12 * (1.0 + range_m)


def random_decoder(number: int, code_length: int = 4) -> Decoder:
    """Return a small ReLU network of the published layout with random weights: any shape, or none, or several."""
    torch.manual_seed(number)
    decoder = Decoder(Architecture(code_length=code_length, width=24, hidden_layers=5, skip_layer=3)).folded().double()
    for layer in decoder.layers:
        torch.nn.init.normal_(layer.weight, std=0.35)
        torch.nn.init.normal_(layer.bias, std=0.2)
    return decoder.requires_grad_(False)


def random_object(number: int, code: Tensor) -> Field:
    """Return an octahedron with bumps of a random ReLU network: one piece, edges everywhere, differentiable by code."""
    bumps = random_decoder(number).field(code)
    return lambda x: 0.5 * x.abs().sum(-1) - 0.35 + 0.1 * bumps(x)
