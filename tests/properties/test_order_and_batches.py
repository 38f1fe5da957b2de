"""The order of points, repeated points and the grouping of beams change nothing, or no more than rounding does."""

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, car, in_frame, sphere
from hypothesis import given
from hypothesis import strategies as st
from property_worlds import EXACT, FAST64, NUMBERS, U64, draw, fan, few, known_to_m, poses, random_decoder, slopes
from random_networks import random_net, random_scene
from torch import Tensor

from shift3d.detectors.grid import assign_pillars
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.geometry.se3 import object_from_scene
from shift3d.render import Beams
from shift3d.render.field.object_field import ObjectField

CENTRE = (12.0, -7.0)


@pytest.fixture(scope="module", params=["pointpillars", "sst"])
def detector(request: pytest.FixtureRequest) -> TrainedDetector:
    return TrainedDetector(random_net(str(request.param)))


@pytest.fixture(scope="module")
def scene() -> Tensor:
    """Points all about the grid, dense about CENTRE, with some rows twice and some that are not finite."""
    generator = torch.Generator().manual_seed(1)
    dense = torch.randn(1500, 3, generator=generator) * torch.tensor([6.0, 6.0, 0.5]) + torch.tensor([*CENTRE, 1.0])
    points = torch.cat((random_scene(1500), dense, dense[:200]))
    points[::301] = torch.nan
    return points


@few(6)
@given(number=NUMBERS)
def test_scores_do_not_depend_on_the_order_of_points(detector: TrainedDetector, scene: Tensor, number: int) -> None:
    window = detector.window_for(CENTRE, 5.0)
    order = torch.from_numpy(np.random.default_rng(number).permutation(len(scene)))
    before, after = (detector.proposals(points, window) for points in (scene, scene[order]))
    assert torch.equal(before.logits, after.logits) and torch.equal(before.boxes, after.boxes)


@few(4)
@given(times=st.integers(2, 6))
def test_every_point_several_times_is_every_point_once(times: int) -> None:
    """A pillar's mean and maximum are those of the same places, in float64.

    The sum of n points of at most 75 m is off by n u 75 m times n, their mean by n u 75 m, and so are offsets to it. A
    logit changes by that times its derivative by them, to first order; the test allows twice as much.
    """
    detector = TrainedDetector(random_net("pointpillars"), "float64")
    window = detector.window_for(CENTRE, 5.0)
    points = random_scene(4000).double() * torch.tensor([0.2, 0.2, 1.0]) + torch.tensor([*CENTRE, 0.0])
    decorated: list[Tensor] = []
    hook = detector._net.pillar_net.register_forward_pre_hook(lambda _, inputs: decorated.append(inputs[0]))
    once = detector.proposals(points.clone().requires_grad_(), window).logits
    hook.remove()
    several = detector.proposals(points.repeat(times, 1), window).logits
    change = (once - several).detach().abs()
    (sensitivity,) = torch.autograd.grad(once[change.argmax()], decorated[0])
    counts = assign_pillars(points, detector.grid, window).counts
    mean_off_m = float(counts.max()) * (times + 1) * U64 * 75.0
    assert float(change.max()) <= 2 * float(sensitivity[:, 3:6].abs().sum()) * mean_off_m
    assert float(once.detach().std()) > 0.1


@few(10)
@given(theta=poses(), number=NUMBERS)
def test_renderings_follow_the_order_of_points(theta: Tensor, number: int) -> None:
    points = fan()
    order = np.random.default_rng(number).permutation(len(points))
    field = in_frame(car(), SHAPENET_FRAME)
    before = draw(Beams.from_arrays(points, np.zeros(3)), field, theta, FAST64)
    after = draw(Beams.from_arrays(points[order], np.zeros(3)), field, theta, FAST64)
    # Bit for bit: this field's values do not depend on their place in a batch, so no result may.
    assert before.hit_mask.sum() > 10
    assert torch.equal(after.hit_mask, before.hit_mask[order])
    assert torch.equal(after.points, before.points[order]) and torch.equal(after.range_m, before.range_m[order])


@few(10)
@given(theta=poses(), number=NUMBERS)
def test_points_that_come_twice_are_rendered_alike(theta: Tensor, number: int) -> None:
    points = fan()
    again = np.random.default_rng(number).integers(0, len(points), 60)
    field = in_frame(car(), SHAPENET_FRAME)
    once = draw(Beams.from_arrays(points, np.zeros(3)), field, theta)
    twice = draw(Beams.from_arrays(np.concatenate((points, points[again])), np.zeros(3)), field, theta)
    assert torch.equal(twice.points[len(points) :], twice.points[again])
    # The number of active beams decides how many steps are taken at once: other samples, the same crossings.
    assert torch.equal(twice.hit_mask[: len(points)], once.hit_mask)
    hit = once.hit_mask
    slope = slopes(once, Beams.from_arrays(points, np.zeros(3)), field, theta)
    change = (twice.range_m[: len(points)] - once.range_m)[hit].abs()
    assert bool((change <= 2 * known_to_m(slope, once.range_m[hit])).all())


SHAPES = st.one_of(
    st.just(in_frame(car(), SHAPENET_FRAME)),
    st.just(in_frame(sphere(1.1), SHAPENET_FRAME)),
    NUMBERS.map(lambda number: random_decoder(number % 1000).field(torch.ones(4, dtype=torch.float64))),
)


@few(12)
@given(theta=poses(), field=SHAPES, cuts=st.lists(st.integers(1, 99), max_size=4), batch=st.sampled_from([13, 64]))
def test_beams_rendered_apart_are_beams_rendered_together(
    theta: Tensor, field: Field, cuts: list[int], batch: int
) -> None:
    points = fan(10)
    beams = Beams.from_arrays(points, np.zeros(3))
    whole = draw(beams, field, theta)
    parts = [
        draw(Beams.from_arrays(part, np.zeros(3)), field, theta, EXACT.with_(batch=batch))
        for part in np.split(points, sorted(set(cuts)))
    ]
    hit = torch.cat([part.hit_mask for part in parts])
    # Samples differ where the few remaining beams are stepped ahead: a chord shorter than the smallest step is found by
    # chance, a longer chord always.
    assert not bool((hit ^ whole.hit_mask)[_long_chords(beams, field, theta)].any())
    both = hit & whole.hit_mask
    if both.any():
        change = (torch.cat([part.range_m for part in parts]) - whole.range_m)[both].abs()
        slope = slopes(whole, beams, field, theta)[both[whole.hit_mask]]
        # The same holds for a short chord in front of a long one: the crossing may then differ.
        same_crossing = change < 0.01
        assert same_crossing.double().mean() > 0.98
        bound = 2 * known_to_m(slope, whole.range_m[both])
        assert bool((change <= bound)[same_crossing].all())


def _long_chords(beams: Beams, field: Field, theta: Tensor) -> Tensor:
    """Return (N,) bool: beams inside for more than 2.5 of the smallest steps, by samples at a third of a step."""
    k = float(theta[:3].norm()) + torch.arange(-3.5, 3.5, EXACT.step_m / 3, dtype=torch.float64)
    metric = ObjectField.of(field, SHAPENET_FRAME, torch.float64, 4096)
    with torch.no_grad():
        places = (beams.directions[:, None] * k[:, None]).reshape(-1, 3)
        inside = (metric(object_from_scene(places, theta)) < 0).reshape(len(beams), -1).double()
    run = torch.nn.functional.avg_pool1d(inside[:, None], kernel_size=9, stride=1)[:, 0]
    return (run > 0.999).any(1)
