"""Both detectors, their encoder, the loss and the scores in float32 against float64, within bounds by `rounding`."""

import copy

import numpy as np
import pytest
import torch
from random_networks import random_net, random_scene
from rounding import EMPTY, U32, RunningError, attention_watched, gamma
from torch import Tensor

from shift3d.attack.objective import adversarial_loss
from shift3d.detectors.base import Proposals
from shift3d.detectors.grid import WAYMO_GRID, Pillars, assign_pillars, full_window
from shift3d.detectors.models.pillar_net import VoxelEncoder, decorate_with_height, segment_mean
from shift3d.detectors.models.sst import SstNet
from shift3d.detectors.nms import suppress
from shift3d.detectors.trained_detector import TrainedDetector

CENTRE = (12.0, -7.0)


@pytest.fixture(scope="module")
def points() -> Tensor:
    """Points (N, 3) float32, several per pillar, about CENTRE."""
    generator = torch.Generator().manual_seed(3)
    near = torch.randn(2500, 3, generator=generator) * torch.tensor([3.0, 3.0, 0.4]) + torch.tensor([*CENTRE, 0.8])
    return torch.cat((random_scene(2000), near))


def decorated_sizes(points: Tensor, pillars: Pillars, columns: int) -> tuple[Tensor, float]:
    """Return the sizes (K, columns) of the terms of the decorated values, and the number of terms of the longest sum.

    x, y, z are the points' own. An offset to the mean is a sum over the pillar, a quotient and a difference: the
    point's coordinate and the mean of all sizes. An offset to the centre, which float32 rounds and which is at most
    half a cell away, has two numbers as large. Height: the coordinate and 1 m.
    """
    xyz = points[pillars.order].double().abs()
    mean = segment_mean(xyz, pillars).index_select(0, pillars.pillar)
    sizes = torch.cat((torch.zeros_like(xyz), xyz + mean, 2 * xyz[:, :2] + 0.16, xyz[:, 2:] + 1.0), 1)
    return sizes[:, :columns], float(pillars.counts.max()) + 2


@pytest.mark.parametrize("name", ["pointpillars", "centerpoint", "sst"])
def test_logits(name: str, points: Tensor) -> None:
    net = random_net(name)
    single, double = TrainedDetector(net), TrainedDetector(net, "float64")
    window = double.window_for(CENTRE, 1.5)
    error, exact_net = RunningError(), double._net
    encoder = exact_net.encoder if isinstance(exact_net, SstNet) else exact_net.pillar_net
    pillars = assign_pillars(points, double.grid, window)

    def decorated(_: torch.nn.Module, inputs: tuple[Tensor, Pillars]) -> tuple[Tensor, Pillars]:
        sizes, terms = decorated_sizes(points, pillars, inputs[0].shape[1])
        return error.add(inputs[0], sizes, terms), inputs[1]

    hook = encoder.register_forward_pre_hook(decorated)
    with error.watch(exact_net), attention_watched(error, longest=144):
        exact = double.proposals(points.double(), window).logits
        found = single.proposals(points, window).logits.double()
        change = (found - exact).detach().abs()
        # The anchors with the largest float32 error, and some others.
        shares = []
        for anchor in [*change.argsort(descending=True)[:3].tolist(), 0, 7]:
            bound = error.bound(exact[anchor])
            assert float(change[anchor]) <= bound
            shares.append(float(change[anchor]) / bound)
    hook.remove()
    assert max(shares) > EMPTY and float(exact.detach().std()) > 0.1


def test_the_voxel_encoder(points: Tensor) -> None:
    """The encoder runs alone, with norms that are not folded: a norm adds a product and a sum, with its own weights."""
    torch.manual_seed(0)
    double = VoxelEncoder(16, 24).double().eval()
    for norm in (double.first_norm, double.second_norm):
        torch.nn.init.uniform_(norm.running_var, 0.5, 1.5)
        torch.nn.init.normal_(norm.running_mean, std=0.1)
    # Both have float32's parameters, so that only the arithmetic differs.
    single = copy.deepcopy(double).float()
    double.load_state_dict(single.state_dict())
    window = full_window(WAYMO_GRID)
    pillars = assign_pillars(points, WAYMO_GRID, window)
    at_64 = decorate_with_height(points.double(), pillars, WAYMO_GRID)
    at_32 = decorate_with_height(points, pillars, WAYMO_GRID)
    sizes, terms = decorated_sizes(points, pillars, 9)
    assert bool(((at_32.double() - at_64).abs() <= gamma(int(terms) + 2) * sizes).all())
    error = RunningError()
    with error.watch(double):
        hooks = [norm.register_forward_hook(_norm_rounding(error)) for norm in (double.first_norm, double.second_norm)]
        exact = double(error.add(at_64, sizes, terms), pillars)
        change = (single(at_32, pillars).double() - exact).detach().abs()
        worst = change.flatten().argsort(descending=True)[:4].tolist()
        shares = [float(change.flatten()[i]) / error.bound(exact.flatten()[i]) for i in worst]
        for hook in hooks:
            hook.remove()
    assert EMPTY < max(shares) <= 1.0


def _norm_rounding(error: RunningError):  # type: ignore[no-untyped-def]
    """Record a batch norm in evaluation mode: a difference, a quotient by a root, a product, a sum."""

    def hook(norm: torch.nn.BatchNorm1d, inputs: tuple[Tensor], output: Tensor) -> Tensor:
        assert norm.running_mean is not None and norm.running_var is not None
        scale = norm.weight.detach().abs() / (norm.running_var + norm.eps).sqrt()
        return error.add(output, (inputs[0].detach().abs() + norm.running_mean.abs()) * scale + norm.bias.abs(), 16)

    return hook


def logits_and_boxes(count: int = 300) -> tuple[Tensor, Tensor]:
    """Return logits from certain misses to certain hits, and boxes about an object at CENTRE."""
    rng = np.random.default_rng(0)
    boxes = np.concatenate((rng.normal(size=(count, 3)) * [2, 2, 0.2] + [*CENTRE, 0.8],
                            rng.uniform(0.8, 1.2, (count, 3)) * [4.5, 1.9, 1.6],
                            rng.uniform(-3, 3, (count, 1))), 1)  # fmt: skip
    return torch.from_numpy(rng.normal(size=count) * 12).float(), torch.from_numpy(boxes).float()


def test_the_loss_and_its_gradient() -> None:
    """A sum w_i softplus(l_i) of n positive terms has n + 6 roundings, a derivative w_i sigmoid(l_i) an error of 6 u.

    The 6: a weight rounded once, softplus accurate to 4 u (an exp and a log1p), and a product; n: the sum.
    """
    logits, boxes = logits_and_boxes()
    truth = np.array([*CENTRE, 0.8, 4.5, 1.9, 1.6, 0.2])
    results = []
    for dtype in (torch.float32, torch.float64):
        leaf = logits.to(dtype).requires_grad_()
        loss = adversarial_loss(Proposals(boxes, leaf, torch.arange(len(leaf))), truth)
        results.append((loss.detach().double(), torch.autograd.grad(loss, leaf)[0].double()))
    (single, slope_single), (double, slope_double) = results
    overlapping = int((slope_double > 0).sum())
    assert overlapping > 50
    assert 0 < float((single - double).abs()) <= gamma(overlapping + 6) * float(double)
    # Where sigmoid is below the smallest normal float32, 1e-38, it has no relative accuracy; no such value occurs.
    assert bool(((slope_single - slope_double).abs() <= gamma(6) * slope_double).all())


def test_scores_and_what_is_kept() -> None:
    """Suppression keeps the same boxes unless two scores are within sigmoid's 4 u: it compares the same overlaps."""
    logits, boxes = logits_and_boxes()
    index = torch.arange(len(logits))
    single = suppress(Proposals(boxes, logits, index), 0.1, 0.25)
    double = suppress(Proposals(boxes, logits.double(), index), 0.1, 0.25)
    assert np.array_equal(single.boxes, double.boxes) and len(single.boxes) > 2
    change = np.abs(single.scores - double.scores)
    assert (change <= gamma(4) * double.scores).all() and (change > EMPTY * U32).any()


def test_saturated_scores_rank_as_in_float64() -> None:
    """Logits above 17 all have the score 1 in float32: suppression must follow the logits, which differ."""
    logits, boxes = torch.tensor([20.0, 30.0]), logits_and_boxes(1)[1].repeat(2, 1)
    boxes[1, 0] += 0.1
    kept = [suppress(Proposals(boxes, part, torch.arange(2)), 0.1, 0.25) for part in (logits, logits.double())]
    assert torch.sigmoid(logits)[0] == torch.sigmoid(logits)[1]
    assert all(np.array_equal(found.boxes, boxes[1:].double().numpy()) for found in kept)
