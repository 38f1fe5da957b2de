"""Moving the whole scene, up to 20 km and by any rotation, changes no hit and no score, within a bound.

The bound. At a distance D from the origin of coordinates a float64 coordinate is a multiple of 2 u D, u = 1.1e-16.
Storing a place therefore moves it by up to sqrt(3) u D; rotating it by a few u of its (local) length before that is
small in comparison. A hit depends on three stored places: sensor, return and object. The beam may be displaced against
the object by 2 sqrt(3) u D at its own sensor and centre, and as much again at its return: E = 4 sqrt(3) u D, 4.3e-11 m
at D = 35 km (20 km along each axis). Attitude angles are rounded too: u times pi times the reach of a beam (40 m). The
range of a hit then changes by E / |e . grad g|, and the error of each of the two roots is `known_to_m`.

What is NOT invariant: a detector sees its sensor's frame, in which its cells and anchors lie. Turning the world under a
fixed sensor rightly changes a score. The invariant is the pipeline's: a world that moves with its sensor is, in the
sensor's frame, the same scene.
"""

import math

import numpy as np
import torch
from analytic_fields import SHAPENET_FRAME, Field, car, in_frame, sphere
from hypothesis import given
from hypothesis import strategies as st
from property_worlds import (
    ANGLES,
    U64,
    draw,
    fan,
    few,
    known_to_m,
    moved_pose,
    poses,
    rotations,
    shifts,
    slopes,
    soft_cars,
)
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.objective import adversarial_loss, object_box, to_network_frame
from shift3d.geometry.se3 import scene_R_object
from shift3d.render import Beams

POINTS = fan()
HERE = Beams.from_arrays(POINTS, np.zeros(3))
SHAPES = st.one_of(
    soft_cars(), st.just(in_frame(sphere(1.1), SHAPENET_FRAME)), st.just(in_frame(car(), SHAPENET_FRAME))
)


def displaced_m(shift: Tensor) -> float:
    """Return E of the module's docstring."""
    return 4 * math.sqrt(3) * U64 * float(shift.norm() + 40.0) + math.pi * U64 * 40.0


@few(15)
@given(theta=poses(), field=SHAPES, rotation=rotations(), moved_by=shifts())
def test_hits_move_with_the_scene(theta: Tensor, field: Field, rotation: Tensor, moved_by: Tensor) -> None:
    points = torch.from_numpy(POINTS) @ rotation.T + moved_by
    there = Beams.from_arrays(points, moved_by)
    before = draw(HERE, field, theta)
    after = draw(there, field, moved_pose(theta, rotation, moved_by))
    # A beam within E of the silhouette may come or go: 1e-10 of the object's width, and the examples are fixed.
    assert torch.equal(before.hit_mask, after.hit_mask)
    hit = before.hit_mask
    assert hit.sum() > 10
    change = (before.range_m - after.range_m).abs()
    # A beam that misses keeps its return, which was stored once more.
    assert float(change[~hit].max()) <= displaced_m(moved_by)
    slope = slopes(before, HERE, field, theta)
    bound = displaced_m(moved_by) / slope + 2 * known_to_m(slope, before.range_m[hit])
    assert bool((change[hit] <= bound).all())
    back = (after.points - moved_by) @ rotation
    assert bool(((back - before.points)[hit].norm(dim=-1) <= bound + displaced_m(moved_by)).all())


@few(8)
@given(theta=poses(), field=soft_cars(), heading=ANGLES, moved_by=shifts())
def test_the_score_of_a_world_that_moves_with_its_sensor(
    theta: Tensor, field: Field, heading: float, moved_by: Tensor
) -> None:
    """A vehicle's pose goes to a map in float64 and back to the sensor's frame: the detector's answer stays."""
    turn = scene_R_object(torch.tensor([0.0, 0.0, 0.0, heading, 0.0, 0.0], dtype=torch.float64))
    in_world = torch.from_numpy(POINTS) @ turn.T + moved_by
    came_back = (in_world - moved_by) @ turn
    theta_world = moved_pose(theta, turn, moved_by)
    theta_back = moved_pose(theta_world, turn.T, -(turn.T @ moved_by))
    box = object_box(theta, SHAPENET_FRAME.size_m, -1.73)
    detector = WaveDetector()
    window = detector.window_for((float(theta[0]), float(theta[1])), 8.0)

    def loss_of(points: Tensor) -> Tensor:
        return adversarial_loss(detector.proposals(to_network_frame(points, -1.73), window), box)

    before = draw(HERE, field, theta)
    after = draw(Beams.from_arrays(came_back, torch.zeros(3)), field, theta_back)
    assert torch.equal(before.hit_mask, after.hit_mask)
    leaf = before.points.clone().requires_grad_()
    (sensitivity,) = torch.autograd.grad(loss_of(leaf), leaf)
    # Every point moves by less than this, a hit along its beam. To first order the loss changes by |gradient| times
    # that; twice as much covers the second order of a move of 1e-10 m. The loss's own sums add their rounding.
    moves = torch.full((len(POINTS),), 2 * displaced_m(moved_by), dtype=torch.float64)
    slope = slopes(before, HERE, field, theta)
    moves[before.hit_mask] += displaced_m(moved_by) / slope + 2 * known_to_m(slope, before.range_m[before.hit_mask])
    first_order = float((sensitivity.norm(dim=-1) * moves).sum())
    rounding = len(POINTS) * U64 * (1.0 + float(loss_of(before.points)))
    assert abs(float(loss_of(before.points) - loss_of(after.points))) <= 2 * first_order + rounding


def test_turning_the_world_under_the_sensor_does_change_a_score() -> None:
    """The property above would be vacuous if the detector ignored places."""
    theta = torch.tensor([14.0, 0.0, -1.0, 0.3, 0.0, 0.0], dtype=torch.float64)
    points = draw(HERE, in_frame(car(), SHAPENET_FRAME), theta).points
    turn = scene_R_object(torch.tensor([0.0, 0.0, 0.0, 0.4, 0.0, 0.0], dtype=torch.float64))
    box = object_box(theta, SHAPENET_FRAME.size_m, -1.73)
    turned_box = object_box(moved_pose(theta, turn, torch.zeros(3)), SHAPENET_FRAME.size_m, -1.73)
    scores = [
        float(adversarial_loss(WaveDetector().proposals(to_network_frame(cloud, -1.73)), where))
        for cloud, where in ((points, box), (points @ turn.T, turned_box))
    ]
    assert abs(scores[0] - scores[1]) > 1e-3
