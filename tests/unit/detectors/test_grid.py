"""Pillars against a plain Python reference."""

import numpy as np
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, assign_pillars, concatenate_pillars, full_window
from shift3d.detectors.models.pillar_net import decorate

WINDOW = BevWindow(200, 220, 40, 30, 200, 220, 40, 30)


def _points(count: int = 500, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    points = rng.uniform((-12.0, -6.0, -2.5), (4.0, 7.0, 4.5), (count, 3)).astype(np.float32)
    points[: count // 2, :2] = np.round(points[: count // 2, :2])  # crowded pillars
    return torch.from_numpy(points)


def _plain_pillars(points: torch.Tensor, window: BevWindow) -> dict[tuple[int, int], list[int]]:
    grid, pillars = WAYMO_GRID, {}
    for index, (x, y, z) in enumerate(points.double().tolist()):
        column = int(np.floor((x - grid.x_min_m) / grid.cell_m))
        line = int(np.floor((y - grid.y_min_m) / grid.cell_m))
        in_window = window.x0 <= column < window.x0 + window.num_x and window.y0 <= line < window.y0 + window.num_y
        if in_window and grid.z_min_m <= z < grid.z_max_m:
            pillars.setdefault((line, column), []).append(index)
    return pillars


def test_pillars_and_decoration_equal_the_plain_reference() -> None:
    points = _points()
    pillars = assign_pillars(points, WAYMO_GRID, WINDOW)
    features = decorate(points, pillars, WAYMO_GRID)
    plain = _plain_pillars(points, WINDOW)
    assert len(plain) == pillars.counts.numel()
    assert sum(map(len, plain.values())) == pillars.order.numel() == features.shape[0]
    for row, index in enumerate(pillars.order.tolist()):
        cell = (int(pillars.cell_y[pillars.pillar[row]]), int(pillars.cell_x[pillars.pillar[row]]))
        members = points[plain[cell]].double()
        assert index in plain[cell]
        centre = -74.88 + (torch.tensor([cell[1], cell[0]], dtype=torch.float64) + 0.5) * 0.32
        point = points[index].double()
        wanted = torch.cat((point, point - members.mean(dim=0), point[:2] - centre))
        assert torch.allclose(features[row].double(), wanted, atol=1e-5)


def test_sorted_points_do_not_depend_on_the_input_order() -> None:
    points = _points()
    shuffled = points[torch.randperm(len(points), generator=torch.Generator().manual_seed(1))]
    one, two = (assign_pillars(p, WAYMO_GRID, WINDOW) for p in (points, shuffled))
    assert torch.equal(points[one.order], shuffled[two.order])
    assert torch.equal(one.counts, two.counts)


def test_points_out_of_range_or_not_finite_are_left_out() -> None:
    inside = torch.tensor([[1.0, 2.0, 0.5]])
    outside = torch.tensor(
        [
            [75.0, 0, 0],
            [-75.0, 0, 0],
            [0, 74.9, 0],
            [0, 0, 4.0],
            [0, 0, -2.1],
            [float("nan"), 0, 0],
            [0, float("inf"), 0],
        ]
    )
    pillars = assign_pillars(torch.cat((outside, inside)), WAYMO_GRID, full_window(WAYMO_GRID))
    assert pillars.order.tolist() == [len(outside)]


def test_no_points() -> None:
    pillars = assign_pillars(torch.zeros(0, 3), WAYMO_GRID, full_window(WAYMO_GRID))
    assert pillars.order.numel() == pillars.counts.numel() == 0


def test_clouds_side_by_side_have_the_pillars_of_each() -> None:
    """One cloud has no valid point, and windows share cells: no point passes from one cloud to another."""
    clouds = [_points(400, seed) for seed in (1, 2)]
    clouds.insert(1, torch.full((3, 3), 1e4))
    parts = [assign_pillars(points, WAYMO_GRID, WINDOW) for points in clouds]
    together, every = concatenate_pillars(parts, [len(points) for points in clouds]), torch.cat(clouds)
    assert len(parts[1].counts) == 0 and len(parts[0].counts) > 1
    assert torch.equal(every[together.order], torch.cat([own[part.order] for own, part in zip(clouds, parts)]))
    assert torch.equal(together.pillar, torch.arange(len(together.counts)).repeat_interleave(together.counts))
    for name in ("counts", "cell_x", "cell_y"):
        assert torch.equal(getattr(together, name), torch.cat([getattr(part, name) for part in parts])), name
    assert concatenate_pillars(parts[:1], [len(clouds[0])]) is parts[0]
