"""Properties of both networks for any weights: exact windows, determinism, true gradients."""

import dataclasses

import pytest
import torch
from random_networks import random_net, random_scene

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.backbone import WAYMO_BACKBONE, Backbone, BackboneSpec
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError


@pytest.fixture(scope="module", params=["pointpillars", "centerpoint", "sst"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def slim(name: str) -> TrainedDetector:
    return TrainedDetector(random_net(name))


@pytest.fixture(scope="module")
def full_scene(slim: TrainedDetector) -> tuple[torch.Tensor, torch.Tensor]:
    found = slim.proposals(random_scene())
    return found.logits, found.boxes


def test_margin_is_the_receptive_field() -> None:
    """The test measures how far the gradient of an output cell reaches in the input, through the real layers."""
    torch.manual_seed(0)
    backbone = Backbone(dataclasses.replace(WAYMO_BACKBONE, in_channels=2, channels=(2, 2, 2), up_channels=2)).eval()
    for module in backbone.modules():
        if isinstance(module, torch.nn.Conv2d | torch.nn.ConvTranspose2d):
            torch.nn.init.constant_(module.weight, 0.1)  # positive: no ReLU hides a path
    backbone.double()
    reach = 0
    for phase in range(4):
        canvas = torch.ones(1, 2, 128, 128, dtype=torch.float64, requires_grad=True)
        backbone(canvas)[0, :, 64 + phase, 64 + phase].sum().backward()
        assert canvas.grad is not None
        touched = torch.nonzero(canvas.grad[0].abs().sum(dim=0))
        offsets = (touched - (64 + phase)).abs()
        reach = max(reach, int(offsets.max()))
    assert WAYMO_BACKBONE.margin_cells == reach == 40


@pytest.mark.parametrize("centre", [(10.0, -7.3), (-73.0, 74.0), (70.0, 20.0), (0.0, -74.5)])
def test_a_window_gives_the_full_scene_s_proposals(
    slim: TrainedDetector, full_scene: tuple[torch.Tensor, torch.Tensor], centre: tuple[float, float]
) -> None:
    window = slim.window_for(centre, 8.0)
    part = slim.proposals(random_scene(), window)
    logits, boxes = full_scene
    assert logits[part.anchor_index].std() > 0.1
    assert torch.allclose(part.logits, logits[part.anchor_index], atol=1e-5, rtol=0)
    assert torch.allclose(part.boxes, boxes[part.anchor_index], atol=1e-4, rtol=1e-5)


def test_a_window_reports_every_cell_in_the_radius(slim: TrainedDetector) -> None:
    window = slim.window_for((30.1, -12.2), 6.0)
    found = slim.proposals(random_scene(), window).anchor_index
    per_cell = len(found) // (window.core_num_x * window.core_num_y)
    lines, columns = torch.meshgrid(torch.arange(468), torch.arange(468), indexing="ij")
    x, y = (-74.88 + 0.32 * (axis + 0.5) for axis in (columns, lines))
    wanted = torch.nonzero((torch.hypot(x - 30.1, y + 12.2) <= 6.0).reshape(-1)).squeeze(1)
    assert len(wanted) > 1000
    assert set((per_cell * wanted[:, None] + torch.arange(per_cell)).reshape(-1).tolist()) <= set(found.tolist())


def test_a_window_gives_the_full_scene_s_gradient(slim: TrainedDetector) -> None:
    window = slim.window_for((-68.0, 3.0), 5.0)
    gradients = []
    for where in (window, None):
        points = random_scene().requires_grad_()
        found = slim.proposals(points, where)
        inside = torch.isin(found.anchor_index, slim.proposals(points.detach(), window).anchor_index)
        torch.nn.functional.softplus(found.logits[inside]).sum().backward()
        assert points.grad is not None
        gradients.append(points.grad)
    assert gradients[0].abs().max() > 1e-3
    assert torch.allclose(*gradients, atol=1e-5, rtol=0)


def test_a_window_beyond_the_grid_is_refused(slim: TrainedDetector) -> None:
    with pytest.raises(InputError, match="detector window"):
        slim.window_for((100.0, 0.0), 5.0)


def test_bitwise_equal_over_runs_and_permutations(slim: TrainedDetector) -> None:
    window = slim.window_for((5.0, 5.0), 6.0)
    points = random_scene()
    points[:6000, :2] = points[:6000, :2] * 0.1  # crowded pillars
    points = torch.cat((points, points[:500]))  # and duplicate points
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(3))
    results = []
    for cloud, back in ((points, None), (points, None), (points[order], torch.argsort(order))):
        leaf = cloud.clone().requires_grad_()
        found = slim.proposals(leaf, window)
        torch.nn.functional.softplus(found.logits).sum().backward()
        assert leaf.grad is not None
        gradient = leaf.grad if back is None else leaf.grad[back]
        # Of two points in one place either may be the maximum after rounding: only the sum of their gradients is fixed.
        together = torch.cat((gradient[:500] + gradient[20000:], gradient[500:20000]))
        results.append((found.logits, found.boxes, together))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_folding_changes_nothing(name: str) -> None:
    net = random_net(name).double()
    window = BevWindow(200, 200, 64, 48, 200, 200, 64, 48)
    points = random_scene().double()
    with torch.no_grad():
        logits = net([points], [window])
        folded = TrainedDetector(net, "float64").proposals(points, window)
    assert torch.allclose(logits[0], folded.logits, atol=1e-10, rtol=0)


@pytest.mark.parametrize("returns", [1, 2], ids=["one return a beam", "two in the same place"])
def test_gradient_equals_central_differences_in_float64(name: str, returns: int) -> None:
    """An object in front of both returns of a beam moves them to one place."""
    detector = TrainedDetector(random_net(name), "float64")
    window = detector.window_for((3.0, 2.0), 2.0)
    generator = torch.Generator().manual_seed(5)
    cloud = torch.rand(400, 3, generator=generator, dtype=torch.float64) * torch.tensor([6.0, 6.0, 1.5])
    cloud = cloud.repeat(returns, 1)

    def loss(points: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.softplus(detector.proposals(points, window).logits).sum()

    leaf = cloud.clone().requires_grad_()
    loss(leaf).backward()
    assert leaf.grad is not None
    # A step so small that no point leaves its pillar and no maximum or ReLU switches along it.
    step = 1e-7
    for trial in range(5):
        direction = torch.randn(400, 3, generator=torch.Generator().manual_seed(trial), dtype=torch.float64)
        direction = direction.repeat(returns, 1)
        difference = (loss(cloud + step * direction) - loss(cloud - step * direction)) / (2 * step)
        exact = (leaf.grad * direction).sum()
        assert abs(float(exact)) > 1e-2
        assert float(difference) == pytest.approx(float(exact), rel=1e-4)


@pytest.mark.parametrize("cloud", [torch.zeros(0, 3), torch.full((5, 3), 500.0)])
def test_a_scene_without_points_in_range_is_valid(slim: TrainedDetector, cloud: torch.Tensor) -> None:
    window = slim.window_for((0.0, 0.0), 3.0)
    points = cloud.clone().requires_grad_()
    found = slim.proposals(points, window)
    assert torch.isfinite(found.logits).all() and torch.isfinite(found.boxes).all()
    detections = slim.detect(cloud, window, score_threshold=1.0)
    assert detections.boxes.shape == (0, 7) and detections.scores.shape == (0,)


def test_bfloat16_stays_near_float32(name: str) -> None:
    net = random_net(name)
    exact, rough = TrainedDetector(net), TrainedDetector(net, "bfloat16")
    window = exact.window_for((0.0, 0.0), 4.0)
    one, two = exact.proposals(random_scene(), window), rough.proposals(random_scene(), window)
    assert two.logits.dtype == torch.float32
    assert (one.logits - two.logits).abs().max() < 0.1 * one.logits.abs().max()


def test_wrong_shape_is_refused(slim: TrainedDetector) -> None:
    with pytest.raises(InputError, match=r"\(N, 3\)"):
        slim.proposals(torch.zeros(5, 4))


def test_training_takes_its_statistics_over_the_whole_canvas() -> None:
    """A core saves work in evaluation; in training, batch norms must still see the whole canvas."""
    spec = BackboneSpec(in_channels=4, channels=(4, 4, 4), up_channels=4, layers=(1, 1, 1))
    canvas = torch.randn(1, 4, 64, 64, generator=torch.Generator().manual_seed(0))
    seen = []
    for core in (None, (24, 24, 8, 8)):
        torch.manual_seed(1)
        backbone = Backbone(spec).train()
        backbone(canvas, core)
        seen.append(torch.cat([module.running_mean for module in backbone.blocks.modules() if hasattr(module, "eps")]))
    assert torch.equal(*seen)
