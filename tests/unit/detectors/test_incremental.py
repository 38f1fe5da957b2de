"""Incremental inference gives the result of the whole frame, and computes no more than necessary."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pytest
import torch
from random_networks import random_net, random_scene
from torch.utils.flop_counter import FlopCounterMode

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.incremental.inference import IncrementalInference, UncachedInference, incremental_inference
from shift3d.detectors.incremental.pillars import IncrementalPillars
from shift3d.detectors.incremental.tokens import IncrementalTokens
from shift3d.detectors.loading import load_detector
from shift3d.detectors.models.sst import SstNet
from shift3d.detectors.models.token_windows import Tokens
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.scenes.sets import StreetScenes

CENTRE = (10.0, -7.3)
Edit = Callable[[torch.Tensor], torch.Tensor]


@pytest.fixture(scope="module", params=["pointpillars", "centerpoint", "sst"])
def exact(request: pytest.FixtureRequest) -> TrainedDetector:
    return TrainedDetector(random_net(request.param), "float64")


@pytest.fixture(scope="module", params=["pointpillars", "centerpoint", "sst"])
def single(request: pytest.FixtureRequest) -> TrainedDetector:
    return TrainedDetector(random_net(request.param))


def _scene() -> torch.Tensor:
    """Return a random scene with a dense cluster, the size of a car, around CENTRE."""
    points = random_scene()
    car = torch.rand(600, 3, generator=torch.Generator().manual_seed(7)) * torch.tensor([4.4, 1.8, 1.5])
    return torch.cat((points, car + torch.tensor([CENTRE[0] - 2.2, CENTRE[1] - 0.9, 0.1])))


def _near(points: torch.Tensor, centre: tuple[float, float], radius_m: float) -> torch.Tensor:
    return torch.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1]) < radius_m


def _moved(points: torch.Tensor, rows: torch.Tensor, offset: tuple[float, float, float]) -> torch.Tensor:
    return points + rows.to(points)[:, None] * torch.tensor(offset, dtype=points.dtype)


def _loss(found: Proposals) -> torch.Tensor:
    """Return a loss of some logits only, each with its own weight."""
    generator = torch.Generator().manual_seed(1)
    weight = torch.rand(found.logits.shape, generator=generator)
    return (weight * (weight > 0.6) * torch.nn.functional.softplus(found.logits)).sum()


def _seen(ask: Callable[[torch.Tensor], Proposals], points: torch.Tensor) -> tuple[Proposals, torch.Tensor]:
    leaf = points.clone().requires_grad_()
    found = ask(leaf)
    (gradient,) = torch.autograd.grad(_loss(found), leaf)
    return found, gradient


@functools.lru_cache(maxsize=16)
def _plain(
    detector: TrainedDetector, points: bytes, dtype: torch.dtype, window: BevWindow
) -> tuple[Proposals, torch.Tensor]:
    """Return the result of the whole window, cached by points: many tests begin and end with the same frame."""
    cloud = torch.frombuffer(bytearray(points), dtype=dtype).reshape(-1, 3)
    return _seen(lambda cloud: detector.proposals(cloud, window), cloud)


def _assert_same(
    detector: TrainedDetector,
    incremental: IncrementalInference,
    points: torch.Tensor,
    window: BevWindow,
    requires_grad: torch.Tensor | None = None,
    tolerance: float = 1e-9,
) -> None:
    """Check logits, boxes, indices and gradients, each against its largest value."""
    found, gradient = _seen(lambda cloud: incremental.proposals(cloud, window, requires_grad), points)
    plain, expected = _plain(detector, points.numpy().tobytes(), points.dtype, window)
    assert torch.equal(found.anchor_index, plain.anchor_index) and found.logits.dtype == plain.logits.dtype
    assert float(plain.logits.detach().std()) > 0.1 and float(expected.abs().max()) > 1e-3
    difference = (found.logits - plain.logits).detach().abs().max()
    assert float(difference) <= tolerance * float(plain.logits.detach().abs().max())
    turned = torch.remainder(found.boxes[:, 6] - plain.boxes[:, 6] + 1.0, torch.pi) - 1.0  # a tie may turn a box round
    assert float((found.boxes - plain.boxes)[:, :6].abs().max()) <= max(tolerance, 1e-6) * 100.0
    assert (found.reported is None) == (plain.reported is None)
    if found.reported is not None and plain.reported is not None:
        assert torch.equal(found.reported, plain.reported) and 0.0 < float(plain.reported.float().mean()) < 1.0
    assert float(turned.abs().max()) <= max(tolerance, 1e-6) * 10.0
    rows = slice(None) if requires_grad is None else requires_grad
    assert float((gradient - expected)[rows].abs().max()) <= tolerance * float(expected.abs().max())


EDITS: dict[str, Edit] = {
    "nothing": lambda p: p,
    "a few points": lambda p: _moved(p, torch.arange(len(p)) % 4001 == 5, (0.4, -0.2, 0.1)),
    "the car": lambda p: _moved(p, _near(p, CENTRE, 3.0), (0.7, 0.5, 0.05)),
    "the car within its cells": lambda p: _moved(p, _near(p, CENTRE, 3.0), (1e-4, 0.0, 0.0)),
    "removed far away": lambda p: _moved(p, _near(p, (24.0, -14.0), 6.0), (500.0, 0.0, 0.0)),
    "brought from far away": lambda p: torch.where(
        (torch.arange(len(p)) < 300)[:, None], p * 0.02 + p.new_tensor([*CENTRE, 1.0]), p
    ),
    "beyond the heights": lambda p: _moved(p, _near(p, CENTRE, 1.0), (0.0, 0.0, 9.0)),
    "no number": lambda p: torch.where((torch.arange(len(p)) % 50 == 0)[:, None], float("nan"), p),
    "everything": lambda p: _moved(p, torch.ones(len(p), dtype=torch.bool), (0.3, 0.3, 0.0)),
    "fewer points": lambda p: p[torch.arange(len(p)) % 7 != 0],
    "more points": lambda p: torch.cat((p, p[:2000] * 0.2)),
    "another order": lambda p: p.flip(0),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_scene_gives_what_it_gives_afresh(exact: TrainedDetector, edit: str) -> None:
    points, window = _scene().double(), exact.window_for(CENTRE, 5.0)
    incremental = exact.incremental(window)
    assert isinstance(incremental, IncrementalPillars | IncrementalTokens)
    edited = EDITS[edit](points)
    for cloud in (points, edited, points):
        _assert_same(exact, incremental, cloud, window)


@pytest.mark.parametrize("edit", ["nothing", "the car", "removed far away"])
def test_in_single_precision(single: TrainedDetector, edit: str) -> None:
    points, window = _scene(), single.window_for(CENTRE, 5.0)
    incremental = single.incremental(window)
    for cloud in (points, EDITS[edit](points)):
        _assert_same(single, incremental, cloud, window, tolerance=1e-4)


@pytest.mark.parametrize("name", ["pointpillars", "centerpoint", "sst"])
def test_in_bfloat16(name: str) -> None:
    rough = TrainedDetector(random_net(name), "bfloat16")
    points, window = _scene(), rough.window_for(CENTRE, 2.0)
    incremental = rough.incremental(window)
    for cloud in (points, EDITS["the car"](points)):
        _assert_same(rough, incremental, cloud, window, tolerance=0.05)  # eight bits, rounded in another order


@pytest.mark.parametrize("centre", [(-73.0, 74.0), (70.0, 20.0), (0.0, -74.5)])
def test_at_the_border_of_the_grid(exact: TrainedDetector, centre: tuple[float, float]) -> None:
    """Every layer reads zeros beyond the border; points move along the border, over it, and back."""
    points = random_scene().double()
    window = exact.window_for(centre, 5.0)
    incremental = exact.incremental(window)
    near = _near(points, centre, 8.0)
    inwards = tuple(-0.9 if c > 0 else 0.9 for c in centre)
    for offset in ((0.0, 0.0), inwards, (-inwards[0], 0.2), (0.0, 0.0)):
        _assert_same(exact, incremental, _moved(points, near, (*offset, 0.0)), window)


def test_at_the_border_of_the_window(exact: TrainedDetector) -> None:
    points, window = _scene().double(), exact.window_for(CENTRE, 5.0)
    incremental = exact.incremental(window)
    edge_x = exact.grid.x_min_m + window.x0 * exact.grid.cell_m
    along = (points[:, 0] - edge_x).abs() < 1.5
    assert int(along.sum()) > 50
    for shift in (0.0, 1.0, -1.0):
        _assert_same(exact, incremental, _moved(points, along, (shift, 0.0, 0.0)), window)


def test_the_core_moves_and_finds_what_changed_where_it_did_not_look(exact: TrainedDetector) -> None:
    points = _scene().double()
    incremental = exact.incremental(exact.window_for(CENTRE, 9.0))
    here, there = exact.window_for(CENTRE, 4.0), exact.window_for((CENTRE[0] - 4.5, CENTRE[1] + 4.5), 4.0)
    far_side = _near(points, (CENTRE[0] - 18.0, CENTRE[1] + 18.0), 5.0)
    assert int(far_side.sum()) > 30
    _assert_same(exact, incremental, points, there)
    points = _moved(points, far_side, (0.5, 0.0, 0.3))  # partly visible from here: the rest must be remembered
    for window in (here, there, here, exact.window_for(CENTRE, 9.0)):
        _assert_same(exact, incremental, points, window)


@pytest.mark.parametrize("cells_away", [30, 34, 36, 38])
def test_a_change_at_the_rim_of_what_is_seen_is_kept_in_mind(exact: TrainedDetector, cells_away: int) -> None:
    """One core sees the change in a few layers alone, the next core in all, without a new change around it."""
    points, cell = _scene().double(), exact.grid.cell_m
    incremental = exact.incremental(exact.window_for(CENTRE, 8.0))
    here, there = exact.window_for(CENTRE, 3.0), exact.window_for((CENTRE[0] - 4.5, CENTRE[1]), 3.0)
    column = exact.grid.x_min_m + (here.core_x0 - cells_away) * cell
    strip = (points[:, 0] >= column) & (points[:, 0] < column + cell) & ((points[:, 1] - CENTRE[1]).abs() < 6.0)
    assert int(strip.sum()) > 0
    _assert_same(exact, incremental, points, there)
    points = _moved(points, strip, (0.0, 0.0, 0.5))
    for window in (here, there):
        _assert_same(exact, incremental, points, window)


def test_many_frames_in_a_row(exact: TrainedDetector) -> None:
    generator = torch.Generator().manual_seed(2)
    points = _scene().double()
    incremental = exact.incremental(exact.window_for(CENTRE, 8.0))
    for _ in range(6):
        x, y, radius = (float(v) for v in torch.rand(3, generator=generator, dtype=torch.float64))
        centre = (CENTRE[0] + 8.0 * x - 4.0, CENTRE[1] + 8.0 * y - 4.0)
        points = _moved(points, _near(points, centre, 1.0 + 3.0 * radius), (x - 0.5, y - 0.5, 0.1 * radius))
        _assert_same(exact, incremental, points, exact.window_for(centre, 4.0))


def test_points_that_require_it_get_their_gradient_whether_they_moved_or_not(exact: TrainedDetector) -> None:
    points, window = _scene().double(), exact.window_for(CENTRE, 5.0)
    incremental = exact.incremental(window)
    requires_grad = torch.arange(len(points)) >= 20000
    for edit in ("nothing", "nothing", "the car", "removed far away"):
        _assert_same(exact, incremental, EDITS[edit](points), window, requires_grad)


def test_forks_answer_as_if_they_were_alone(single: TrainedDetector) -> None:
    """Answers are equal bit for bit, whatever other forks of the same frame were evaluated."""
    points, window = _scene(), single.window_for(CENTRE, 5.0)
    moved, gone = EDITS["the car"](points), EDITS["removed far away"](points)
    incremental = single.incremental(window)
    incremental.proposals(points, window)
    first = incremental.fork().proposals(moved, window).logits
    other = incremental.fork()
    assert not torch.equal(other.proposals(gone, window).logits, first)
    other.proposals(moved, window)
    assert torch.equal(incremental.fork().proposals(moved, window).logits, first)
    _assert_same(single, incremental.fork(), moved, window, tolerance=1e-4)


def test_a_backward_pass_may_wait_for_later_frames(exact: TrainedDetector) -> None:
    points, window = _scene().double(), exact.window_for(CENTRE, 5.0)
    incremental = exact.incremental(window)
    leaf = points.clone().requires_grad_()
    early = _loss(incremental.proposals(leaf, window))
    incremental.proposals(EDITS["everything"](points), window)
    (gradient,) = torch.autograd.grad(early, leaf)
    _, expected = _seen(lambda cloud: exact.proposals(cloud, window), points)
    assert torch.allclose(gradient, expected, atol=1e-9, rtol=0)


def test_the_same_calls_give_the_same_bits(single: TrainedDetector) -> None:
    points, window = _scene(), single.window_for(CENTRE, 5.0)
    results = []
    for _ in range(2):
        incremental = single.incremental(window)
        incremental.proposals(points, window)
        results.append(_seen(lambda cloud, f=incremental: f.proposals(cloud, window), EDITS["the car"](points)))
    assert torch.equal(results[0][0].logits, results[1][0].logits) and torch.equal(results[0][1], results[1][1])


def test_a_window_beyond_the_cached_one_is_computed_as_a_whole(exact: TrainedDetector) -> None:
    points, beyond = _scene().double(), exact.window_for((40.0, 30.0), 5.0)
    found = exact.incremental(exact.window_for(CENTRE, 5.0)).proposals(points, beyond)
    assert torch.equal(found.logits, exact.proposals(points, beyond).logits)


def test_no_window_is_the_cached_one_and_no_points_are_a_scene(exact: TrainedDetector) -> None:
    window = exact.window_for(CENTRE, 4.0)
    incremental = exact.incremental(window)
    for points in (torch.zeros(0, 3, dtype=torch.float64), _scene().double(), torch.full((9, 3), 500.0)):
        found, plain = incremental.proposals(points), exact.proposals(points, window)
        assert torch.allclose(found.logits, plain.logits, atol=1e-9, rtol=0)


def test_a_window_that_is_not_aligned_is_computed_each_time() -> None:
    detector = TrainedDetector(random_net("pointpillars"))
    window = detector.window_for(CENTRE, 3.0)
    incremental = incremental_inference(
        detector, dataclasses.replace(window, x0=window.x0 - 1)
    )  # the coarsest map's cells are cut
    assert isinstance(incremental, UncachedInference)
    for points in (_scene(), EDITS["the car"](_scene())):
        assert torch.equal(incremental.proposals(points, window).logits, detector.proposals(points, window).logits)


def _operations(call: Callable[[], object]) -> int:
    with FlopCounterMode(display=False) as counter:
        call()
    return int(counter.get_total_flops())


@pytest.mark.parametrize("name", ["pointpillars", "centerpoint", "sst"])
def test_nothing_is_computed_for_what_did_not_change_or_is_not_needed(name: str) -> None:
    """The exceptions are the few convolutions behind SST's transformer, which see the core and a little more."""
    single = TrainedDetector(random_net(name))
    points, window = _scene(), single.window_for(CENTRE, 5.0)
    incremental = single.incremental(single.window_for(CENTRE, 9.0))
    first = _operations(lambda: incremental.proposals(points, window))
    assert first < _operations(lambda: single.proposals(points, window)) * 1.01
    idle = _operations(lambda: incremental.proposals(points, window))
    net = single._net
    behind = 0 if not isinstance(net, SstNet) else _operations(lambda: _behind_the_transformer(net, window))
    assert idle == behind
    unseen = _moved(points, _near(points, (CENTRE[0] + 21.0, CENTRE[1] + 21.0), 2.0), (0.0, 0.0, 0.3))
    assert not torch.equal(unseen, points)
    assert _operations(lambda: incremental.proposals(unseen, window)) == behind
    moved = _operations(lambda: incremental.proposals(EDITS["the car"](unseen), window))
    assert 0 < moved - behind < 0.5 * (first - behind)


def _behind_the_transformer(net: SstNet, window: BevWindow) -> None:
    nothing = np.zeros(0, dtype=np.int64)
    features = net.core_features(torch.zeros(0, 16), Tokens(nothing, nothing, nothing), [window])
    net.heads.logits(features)
    net.heads.box_rows(features)


@pytest.mark.parametrize("name, share", [("pointpillars", 0.25), ("sst", 0.6)])
def test_the_shipped_network_sees_a_car_move_across_a_street(name: str, share: float) -> None:
    """A step of an attack moves the car's points; the loss is of the logits around it, the gradient of its points.

    share: of the operations of the plain window. SST's layers spread a change farther than PointPillars' first block.
    """
    detector = load_detector(name)
    scene = StreetScenes("waymo_top", count=1, split="test").load("street-test-waymo_top-000000")
    points = torch.from_numpy(scene.points[scene.has_beam]) - torch.tensor([0.0, 0.0, scene.ground_z_m])
    boxes = scene.labels.boxes[scene.labels.mask("vehicle") & (scene.labels.num_points >= 100)]
    centre = (float(boxes[0, 0]), float(boxes[0, 1]))
    window = detector.window_for(centre, 8.0)
    incremental = detector.incremental(detector.window_for(centre, 12.0))
    car = _near(points, centre, 2.5) & (points[:, 2] > 0.2)
    assert int(car.sum()) >= 50
    _assert_same(detector, incremental, points, window, car, 1e-4)
    _assert_same(detector, incremental, _moved(points, car, (0.05, -0.1, 0.0)), window, car, 1e-4)

    def step_through(ask: Callable[[torch.Tensor], Proposals]) -> int:
        return _operations(lambda: _seen(ask, _moved(points, car, (0.3, 0.0, 0.0))))

    incrementally = step_through(lambda cloud: incremental.proposals(cloud, window, car))
    assert incrementally < share * step_through(lambda cloud: detector.proposals(cloud, window))
