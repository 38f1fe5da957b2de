"""The gradient cases: pose, code, both, networks, and the loss through detectors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from analytic_fields import SHAPENET_FRAME, Field, box, car, in_frame, sector_scan, soft_car, sphere, union
from gradient_cases import EXACT, GradientCase, select, wavy_loss
from random_networks import random_net
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.objective import adversarial_loss, object_box, to_network_frame, window_around
from shift3d.detectors.base import Detector, Proposals
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.geometry.se3 import scene_R_object
from shift3d.render import Beams, Rendering, render

THETA = torch.tensor([12.0, 4.0, -0.9, 0.7, 0.04, -0.06], dtype=torch.float64)
CODE = torch.tensor([0.3, -0.2, 0.1, 0.5, -0.4, 0.8], dtype=torch.float64)
GROUND_Z_M = -2.2
"""Low enough that every hit is above the points that the small detector drops as ground."""


def softplus_network(code: Tensor) -> Field:
    """Return a smooth network with a shape's code as its input, about an ellipsoid; sdf frame."""
    generator = torch.Generator().manual_seed(5)
    sizes = [(32, 3 + len(code)), (32, 32), (1, 32)]
    weights = [torch.randn(*size, generator=generator, dtype=torch.float64) / size[1] ** 0.5 for size in sizes]

    def g(x: Tensor) -> Tensor:
        hidden = torch.cat((2.0 * x, code.to(x).expand(len(x), -1)), 1)
        for weight in weights[:-1]:
            hidden = torch.nn.functional.softplus(hidden @ weight.T, beta=4.0)
        body = (x / x.new_tensor([0.36, 0.28, 0.8])).square().sum(-1).add(0.01).sqrt() - 1.0
        return torch.tanh(0.25 * body + 0.03 * (hidden @ weights[-1].T)[:, 0])

    return g


FIELDS: dict[str, Callable[[Tensor], Field]] = {
    "sphere": lambda code: in_frame(sphere(1.0), SHAPENET_FRAME),
    "soft car": lambda code: in_frame(soft_car(code), SHAPENET_FRAME),
    "network": softplus_network,
    "car": lambda code: in_frame(car(), SHAPENET_FRAME),
}


def fan(rays: int, half_angle_rad: float = 0.2) -> Beams:
    return Beams.from_arrays(*sector_scan((12.0, 4.0, -0.9), half_angle_rad=half_angle_rad, rays=rays))


def inner_beams(name: str) -> Beams:
    """Return beams that meet the surface at more than 24 degrees, so that it may move by centimetres."""
    beams, field = fan(16, 0.15), FIELDS[name](CODE)
    with torch.no_grad():
        rendering = render(beams, field, THETA, SHAPENET_FRAME, EXACT)
    rows = torch.nonzero(rendering.hit_mask).squeeze(1)
    x_object = ((rendering.points[rows] - THETA[:3]) @ scene_R_object(THETA)).requires_grad_()
    x_sdf = x_object @ torch.as_tensor(SHAPENET_FRAME.sdf_R_object).T / SHAPENET_FRAME.scale_m
    g = field(x_sdf + torch.as_tensor(SHAPENET_FRAME.sdf_t_object)) * SHAPENET_FRAME.scale_m
    (normal,) = torch.autograd.grad(g.sum(), x_object)
    normal = torch.nn.functional.normalize(normal, dim=1)
    facing = (normal * (beams.directions[rows] @ scene_R_object(THETA))).sum(-1) < -0.4
    assert facing.sum() > 20
    return select(beams, rows[facing])


Drawing = Callable[[Tensor], Rendering]
VARIABLES = {"pose": THETA, "code": CODE, "code and pose": torch.cat((CODE, THETA))}


def drawing(name: str, variable: str, beams: Beams) -> Drawing:
    """Return a rendering as a function of pose, code or both."""

    def draw(v: Tensor) -> Rendering:
        code, theta = {"pose": (CODE, v), "code": (v, THETA), "code and pose": (v[:6], v[6:])}[variable]
        return render(beams, FIELDS[name](code), theta, SHAPENET_FRAME, EXACT)

    return draw


def of_points(draw: Drawing) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """Return a smooth loss of every coordinate."""

    def loss(v: Tensor) -> tuple[Tensor, Tensor]:
        rendering = draw(v)
        return wavy_loss(rendering.points), rendering.hit_mask

    return loss


def through(detector: Detector, draw: Drawing, at: Tensor) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """Return the adversarial loss. All boxes stay as they are `at`: overlaps are weights without a gradient."""
    truth = object_box(THETA, SHAPENET_FRAME.size_m, GROUND_Z_M)
    window = window_around(detector, THETA, 6.0)

    def proposals(rendering: Rendering) -> Proposals:
        return detector.proposals(to_network_frame(rendering.points, GROUND_Z_M), window)

    with torch.no_grad():
        boxes = proposals(draw(at)).boxes

    def loss(v: Tensor) -> tuple[Tensor, Tensor]:
        rendering = draw(v)
        return adversarial_loss(replace(proposals(rendering), boxes=boxes), truth), rendering.hit_mask

    return loss


def some_directions(at: Tensor) -> Tensor:
    """Return four directions, each of every coordinate: an error in one coordinate shows in all of them."""
    drawn = torch.randn(4, len(at), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return torch.nn.functional.normalize(drawn, dim=1)


def smooth_cases() -> list[GradientCase]:
    """Return cases with steps of a hundredth: central differences err by the third derivative, not by rounding."""
    cases = []
    for name, variable, step in (
        ("sphere", "pose", 2e-3),
        ("soft car", "code and pose", 2e-3),
        ("network", "code and pose", 2e-3),
    ):
        draw = drawing(name, variable, inner_beams(name))
        at, loss = VARIABLES[variable], of_points(draw)
        cases.append(GradientCase(f"{variable} of {name}", "smooth", loss, at, step, 1e-3, some_directions(at)))
    for name, variable, step in (("soft car", "code and pose", 2e-3), ("network", "code", 1e-2)):
        draw = drawing(name, variable, inner_beams(name))
        at = VARIABLES[variable]
        loss, title = through(WaveDetector(), draw, at), f"{variable} of {name}, through a detector"
        cases.append(GradientCase(title, "smooth", loss, at, step, 1e-3, some_directions(at)))
    return cases


def silhouette_cases() -> list[GradientCase]:
    """Return cases with steps of 1e-7, over which no beam may come or go.

    The limb's second derivatives are large, and 1e-13 m of a root is 1e-6 of this step.
    """
    cases = []
    for name, variable in (("sphere", "pose"), ("soft car", "code and pose"), ("network", "code and pose")):
        draw = drawing(name, variable, fan(31))
        title, at = f"{variable} of {name}, whole", VARIABLES[variable]
        loss, some = of_points(draw), some_directions(at)
        cases.append(GradientCase(title, "moving silhouette", loss, at, 1e-7, 1e-4, some))
    loss = through(WaveDetector(), drawing("soft car", "code", fan(31)), CODE)
    title = "code of soft car, whole, through a detector"
    cases.append(GradientCase(title, "moving silhouette", loss, CODE, 1e-7, 1e-4, some_directions(CODE)))
    return cases


POST_AND_SLAB = in_frame(
    union(box((0.05, 0.3, 1.0), (-0.5, 0.0, 0.0)), box((0.2, 1.0, 1.0), (0.7, 0.0, 0.0))), SHAPENET_FRAME
)
AT_TEN = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def at_the_posts_edge(side_m: float) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """Return the loss of a beam this far inside the post's edge at 0.3 m: inside it meets the post, else the slab."""
    y = 0.3 + side_m
    origin = torch.tensor([0.0, y, 0.0], dtype=torch.float64)
    beams = Beams.from_arrays(torch.tensor([[30.0, y, 0.0]], dtype=torch.float64), origin)

    def loss(theta: Tensor) -> tuple[Tensor, Tensor]:
        rendering = render(beams, POST_AND_SLAB, theta, SHAPENET_FRAME, EXACT)
        return wavy_loss(rendering.points), rendering.range_m.detach() < 10.0

    return loss


def discontinuous_cases() -> list[GradientCase]:
    """Return cases with steps shorter than the distance to the jump."""
    cases = []
    for side_m in (-1e-4, 1e-4):
        loss = at_the_posts_edge(side_m)
        cases.append(GradientCase(f"pose, {side_m:+g} m from a jump", "discontinuous", loss, AT_TEN, 1e-6, 1e-6))
    # Edges: a beam within a step of an edge has the normal of either side.
    draw = drawing("car", "pose", inner_beams("car"))
    cases.append(GradientCase("pose of car, edged", "discontinuous", of_points(draw), THETA, 1e-6, 1e-5))
    # Pillars, maxima and ReLUs: piecewise smooth, with jumps where a point changes its pillar.
    detector = TrainedDetector(random_net("pointpillars"), "float64")
    for variable in ("pose", "code"):
        draw, at = drawing("soft car", variable, inner_beams("soft car")), VARIABLES[variable]
        title = f"{variable} of soft car, through pillars"
        cases.append(GradientCase(title, "discontinuous", through(detector, draw, at), at, 1e-6, 1e-4))
    return cases
