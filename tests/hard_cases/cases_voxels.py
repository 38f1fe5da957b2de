"""Hard cases of voxelisation: points on edges and beyond them, crowded and empty pillars, ties of the maximum."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np
import torch
from catalogue import hard_case
from random_networks import random_net
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, Pillars, assign_pillars, full_window
from shift3d.detectors.models.pillar_net import PillarNet, decorate
from shift3d.detectors.trained_detector import TrainedDetector

AREA = "voxelisation"
CENTRE = (10.0, -7.3)
NAN, INF = float("nan"), float("inf")


@cache
def detector(precision: str = "float64", name: str = "pointpillars") -> TrainedDetector:
    """Return a slim network with random weights."""
    return TrainedDetector(random_net(name), precision)  # type: ignore[arg-type]


def window(name: str = "pointpillars") -> BevWindow:
    return detector(name=name).window_for(CENTRE, 2.0)


def cluster(count: int = 400, size_m: float = 4.0, seed: int = 0) -> Tensor:
    """Return (count, 3) float64 points around CENTRE, from the ground to 1.5 m."""
    unit = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return (
        unit * torch.tensor([size_m, size_m, 1.5]) + torch.tensor([*CENTRE, 0.0]) - size_m / 2 * torch.tensor([1, 1, 0])
    )


def seen(points: Tensor, name: str = "pointpillars") -> tuple[Tensor, Tensor]:
    """Return logits of the window around CENTRE, and the gradient of their sum at the points."""
    leaf = points.detach().clone().requires_grad_()
    found = detector(name=name).proposals(leaf, window(name))
    gradient = (
        torch.autograd.grad(found.logits.sum(), leaf)[0] if found.logits.requires_grad else torch.zeros_like(leaf)
    )
    assert torch.isfinite(found.boxes).all()
    return found.logits.detach(), gradient


@hard_case(
    area=AREA,
    why="a float32 coordinate next to an edge falls to either side, by how its cell is rounded",
    must="the cell in which the point exactly is, half open, and the same in every precision of the network",
    guard="cells are computed in float64, whatever the points come in",
)
def a_point_on_a_pillars_edge() -> None:
    edges = (np.arange(1, 468) * 0.32 - 74.88).astype(np.float32)
    x = np.concatenate([np.nextafter(edges, np.float32(side)) for side in (-100, 100)])
    points = torch.from_numpy(np.stack((x, np.zeros_like(x), np.zeros_like(x)), axis=1))
    pillars = assign_pillars(points, WAYMO_GRID, full_window(WAYMO_GRID))
    found = np.empty(len(x), dtype=int)
    found[pillars.order.numpy()] = pillars.cell_x[pillars.pillar].numpy()
    places = [(Fraction(float(value)) + Fraction("74.88")) / Fraction("0.32") for value in x]
    sure = np.abs([float(place - round(place)) for place in places]) > 1e-12  # float64 adds 1e-45 m to nothing, too
    assert sure.sum() >= len(x) - 2
    assert found[sure].tolist() == [
        place.numerator // place.denominator for place, checked in zip(places, sure) if checked
    ]


@hard_case(
    area=AREA,
    why="a point a hand's breadth beyond the last column would be counted into the first one of the next line",
    must="it belongs to no pillar, on any side of the grid and at its very ends",
    guard="columns and lines are held against the window before they become a number",
)
def a_point_just_beyond_the_grid() -> None:
    below = np.nextafter(74.88, 0.0)
    inside = [[-74.88, 0, 0], [0, -74.88, 0], [0, 0, -2.0], [below - 1e-9, below - 1e-9, np.nextafter(4.0, 0.0)]]
    outside = [
        [74.9, 0, 0],
        [-74.89, 0, 0],
        [0, 74.9, 0],
        [0, -74.89, 0],
        [0, 0, 4.0],
        [0, 0, np.nextafter(-2.0, -3.0)],
    ]
    points = torch.tensor(inside + outside, dtype=torch.float64)
    pillars = assign_pillars(points, WAYMO_GRID, full_window(WAYMO_GRID))
    assert sorted(pillars.order.tolist()) == [0, 1, 2, 3]
    assert pillars.cell_x.amin() >= 0 and pillars.cell_x.amax() == pillars.cell_y.amax() == 467


@hard_case(
    area=AREA,
    why="the published network keeps 20 points of a pillar: the others have no gradient, and order decides which",
    must="every point is kept, and the last of 400 has its gradient",
    guard="pillars of any number of points, without a limit",
)
def four_hundred_points_in_one_pillar() -> None:
    points = cluster(size_m=0.1)
    points[-1, 2] = 3.0  # stands out: it is some channel's maximum
    pillars = assign_pillars(points, WAYMO_GRID, window())
    assert pillars.counts.tolist() == [400]
    _, gradient = seen(points)
    assert float(gradient[-1].abs().max()) > 1e-6


@hard_case(
    area=AREA,
    why="a sum of floating-point numbers depends on their order, and so would a score",
    must="the same logits to the bit for any order of the points",
    guard="the points of a pillar are sorted by their coordinates before anything is added",
)
def the_points_in_another_order() -> None:
    points = cluster(1000, size_m=2.0)
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(1))
    for name in ("pointpillars", "centerpoint", "sst"):
        logits, gradient = seen(points, name)
        again, turned = seen(points[order], name)
        assert torch.equal(logits, again)
        assert torch.allclose(gradient[order], turned, rtol=0, atol=1e-12)


@hard_case(
    area=AREA,
    why="two points in one place both hold the maximum: its derivative is not defined",
    must="each gets half of what one point there would get",
    guard="the maximum whose backward pass divides among all that hold it",
)
def two_points_hold_a_pillars_maximum() -> None:
    torch.manual_seed(0)
    net = PillarNet(16).eval()
    net.linear.weight.data.mul_(64).round_()  # sums of few bits: ties are exact
    net.feature_scale.fill_(1.0)

    def gradient(rows: list[list[float]]) -> Tensor:
        decorated = torch.tensor(rows, requires_grad=True)
        none, count = torch.empty(0, dtype=torch.int64), len(rows)
        pillars = Pillars(none, torch.zeros(count, dtype=torch.int64), torch.tensor([count]), none, none)
        return torch.autograd.grad(net(decorated, pillars).sum(), decorated)[0]

    high, low = [1.0, 2.0, 0.5, 0.25, -0.5, 1.5, 0.125, -1.0], [0.0] * 8
    alone, twice = gradient([high, low]), gradient([high, low, high])
    assert float(alone[0].abs().max()) > 0.1
    assert torch.equal(twice[0], twice[2]) and torch.equal(2 * twice[0], alone[0])


@hard_case(
    area=AREA,
    why="a NaN is neither too low nor too high, and a huge coordinate overflows on its way to a cell",
    must="such points are no part of the scene: the logits of the others, and a gradient of 0",
    guard="a point counts only where it is known to be inside",
)
def points_without_a_place() -> None:
    x, y = CENTRE
    bad = [[NAN, y, 0.5], [x, NAN, 0.5], [x, y, NAN], [INF, y, 0.5], [x, -INF, 0.5], [x, y, INF], [1e308, -1e308, 0.0]]
    good = cluster()
    with_bad = torch.cat((torch.tensor(bad, dtype=torch.float64), good))
    for name in ("pointpillars", "centerpoint", "sst"):
        logits, gradient = seen(with_bad, name)
        assert torch.equal(logits, seen(good, name)[0]) and torch.isfinite(gradient).all()
        assert not gradient[: len(bad)].any() and gradient[len(bad) :].any()


@hard_case(
    area=AREA,
    why="bfloat16 knows a coordinate to 0.25 m at 70 m: a point would change its pillar, and its offset be noise",
    must="the features of a far pillar are those of the float32 network to the bit",
    guard="points and the pillar network stay in float32 for any precision of the convolutions",
)
def a_pillar_at_seventy_metres_in_bfloat16() -> None:
    points = (cluster(50, size_m=0.3) + torch.tensor([60.0, 0.0, 0.0])).float()
    nets = [random_net("pointpillars").inference(precision) for precision in ("float32", "bfloat16")]
    (_, single), (pillars, half) = (net.pillar_features(points, full_window(WAYMO_GRID)) for net in nets)  # type: ignore[operator]
    assert torch.equal(single, half)
    offset = decorate(points, pillars, WAYMO_GRID)[:, 3:5]
    mean = points.double()[pillars.order, :2] - torch.stack(
        [points.double()[pillars.order][pillars.pillar == owner, :2].mean(0) for owner in pillars.pillar.tolist()]
    )
    assert float((offset.double() - mean).abs().max()) < 2e-5  # a few roundings of 70 m in float32
