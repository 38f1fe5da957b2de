"""Hard cases of incremental inference: after any sequence of frames it must equal inference on the whole scene."""

from __future__ import annotations

import math

import torch
from cases_voxels import CENTRE, NAN, cluster, detector, seen, window
from catalogue import hard_case
from torch import Tensor

from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.incremental.inference import IncrementalInference

AREA = "detector"


def same_frames(*clouds: Tensor, name: str = "pointpillars", requires_grad: Tensor | None = None) -> None:
    """Check that incremental inference through these frames gives the result of the whole last frame."""
    incremental = detector(name=name).incremental(window(name))
    for cloud in clouds[:-1]:
        incremental.proposals(cloud)
    leaf = clouds[-1].clone().requires_grad_()
    found = incremental.proposals(leaf, requires_grad=requires_grad)
    logits, gradient = seen(clouds[-1], name)
    assert torch.allclose(found.logits, logits, rtol=0, atol=1e-12)
    if found.logits.requires_grad:
        requested = slice(None) if requires_grad is None else requires_grad
        answer = torch.autograd.grad(found.logits.sum(), leaf)[0]
        assert torch.allclose(answer[requested], gradient[requested], rtol=0, atol=1e-12)
    else:
        assert not gradient.any()


def shifted(points: Tensor, rows: slice, *offset: float) -> Tensor:
    points = points.clone()
    points[rows] += torch.tensor(offset, dtype=points.dtype)
    return points


@hard_case(
    area=AREA,
    why="a point that moves to the next cell changes two pillars, the one that it left with the other points in it",
    must="what a fresh look at the scene gives",
    guard="the cells that held a moved point are computed again, as well as those that hold it",
)
def a_point_crosses_into_the_next_cell() -> None:
    points = cluster()
    same_frames(points, shifted(points, slice(0, 40), WAYMO_GRID.cell_m, 0.0, 0.0))


@hard_case(
    area=AREA,
    why="an object that moves on leaves cells without a point, and there is nothing to write into them",
    must="what a fresh look at the scene gives: an empty pillar is 0",
    guard="cells that are due are emptied before they are filled",
)
def an_object_leaves_its_cells_empty() -> None:
    points = cluster(200, size_m=1.0)
    same_frames(points, shifted(points, slice(None), 2.0, -1.5, 0.0))
    same_frames(points, shifted(points, slice(None), 60.0, 0.0, 0.0), points)


@hard_case(
    area=AREA,
    why="the cell of a point without a number is none, and as an integer an arbitrary one",
    must="what a fresh look gives, while such points come and go",
    guard="points without a cell get a number that stands for none",
)
def a_point_is_no_number_for_a_while() -> None:
    points = cluster()
    broken = shifted(points, slice(0, 30), NAN, 0.0, 0.0)
    for away in (
        broken,
        shifted(points, slice(0, 30), math.inf, 0.0, 0.0),
        shifted(points, slice(0, 30), 0.0, 1e300, 0.0),
    ):
        same_frames(points, away)
        same_frames(away, points)


@hard_case(
    area=AREA,
    why="rows of a cloud of another length are other points: moves cannot be found row by row",
    must="what a fresh look gives, from many points to none and back",
    guard="a cloud of another length is taken for new as a whole",
)
def a_cloud_changes_its_length() -> None:
    points, none = cluster(), torch.zeros(0, 3, dtype=torch.float64)
    same_frames(points, none)
    same_frames(none, points)
    same_frames(points, none, points[:100], points[50:], points)


@hard_case(
    area=AREA,
    why="what changed where nobody looked is not computed, and must not be forgotten when somebody does",
    must="what a fresh look at the scene gives, once the window moves there",
    guard="changed cells that are not needed stay due",
)
def a_point_moves_where_nobody_looks() -> None:
    wide = detector().window_for(CENTRE, 9.0)
    here, there = (detector().window_for((CENTRE[0] + d, CENTRE[1]), 2.0) for d in (-7.0, 7.0))
    incremental: IncrementalInference = detector().incremental(wide)
    points = cluster(600, size_m=1.0) + torch.tensor([11.0, 0.0, 0.0], dtype=torch.float64)
    moved = shifted(points, slice(0, 600), 0.3, 0.4, 0.1)
    incremental.proposals(points, there)
    assert torch.equal(incremental.proposals(moved, here).logits, incremental.proposals(points, here).logits)
    incremental.proposals(moved, here)
    found, fresh = incremental.proposals(moved, there), detector().proposals(moved, there)
    assert float((fresh.logits - detector().proposals(points, there).logits).abs().max()) > 1e-3
    assert torch.allclose(found.logits, fresh.logits, rtol=0, atol=1e-12)


@hard_case(
    area=AREA,
    why="what an object uncovers becomes a token among those that stay, and what it hides is none any more",
    must="what a fresh look at the scene gives, from SST too: windows attend the tokens that are there",
    guard="of the cells of a window, those that hold a point are its tokens",
)
def a_token_comes_and_goes() -> None:
    points = cluster(300, size_m=9.0)
    for offset in (1.7, 60.0):
        moved = shifted(points, slice(0, 100), offset, -0.9, 0.0)
        same_frames(points, moved, name="sst")
        same_frames(moved, points, moved, points, name="sst")


@hard_case(
    area=AREA,
    why="the gradient goes through every token of a window, of which a few alone hang on the points that are moved",
    must="at the requested points, the gradient of a fresh look, through every layer",
    guard="tokens that carry a gradient enter a layer as they are, not as they were kept",
)
def a_token_requires_a_gradient_among_others() -> None:
    points = cluster(600, size_m=12.0)
    requires_grad = torch.arange(len(points)) < 40
    same_frames(points, shifted(points, slice(0, 40), 0.2, 0.1, 0.0), name="sst", requires_grad=requires_grad)


@hard_case(
    area=AREA,
    why="a token that changed where nobody looked reaches other windows, layer by layer, once somebody does",
    must="what a fresh look at the scene gives, from SST too, once the window moves there",
    guard="in every layer, windows that changed and are not needed stay due",
)
def a_token_changes_where_nobody_looks() -> None:
    sst = detector(name="sst")
    here, there = (sst.window_for((CENTRE[0] + d, CENTRE[1]), 2.0) for d in (-7.0, 7.0))
    incremental: IncrementalInference = sst.incremental(sst.window_for(CENTRE, 12.0))
    points = torch.cat((cluster(600, size_m=1.0) + torch.tensor([1.0, 0.0, 0.0]), cluster(900, size_m=24.0)))
    moved = shifted(points, slice(0, 600), 0.3, 0.4, 0.1)
    incremental.proposals(points, there)
    for _ in range(2):  # the second call at this place finds no change, and must not forget anything
        incremental.proposals(moved, here)
    found, fresh = incremental.proposals(moved, there), sst.proposals(moved, there)
    assert float((fresh.logits - sst.proposals(points, there).logits).abs().max()) > 1e-4
    assert torch.allclose(found.logits, fresh.logits, rtol=0, atol=1e-12)
