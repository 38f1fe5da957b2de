"""Culling: the remaining beams, and the remaining interval of each."""

import numpy as np
import torch
from analytic_fields import ground_scan

from shift3d.render import Beams
from shift3d.render.culling import Rays, beams_near, clip_to_box, object_rays

LOWER, UPPER = torch.tensor([-1.0, -1.0, -1.0]).double(), torch.tensor([1.0, 1.0, 1.0]).double()


def rays(origins: list[list[float]], directions: list[list[float]], far: float = 100.0) -> Rays:
    o, d = torch.tensor(origins).double(), torch.tensor(directions).double()
    n = len(o)
    return Rays(torch.arange(n), o, d, torch.zeros(n).double(), torch.full((n,), far).double())


def test_stretch_inside_a_box() -> None:
    cut = clip_to_box(rays([[-5, 0, 0]], [[1, 0, 0]]), LOWER, UPPER)
    assert cut.near_m.tolist() == [4.0] and cut.far_m.tolist() == [6.0]


def test_rays_parallel_to_faces() -> None:
    # Inside the slab, in the face itself, outside, and negative zero as a component.
    cut = clip_to_box(
        rays(
            [[-5, 0.5, 0], [-5, 1.0, 0], [-5, 1.0001, 0], [-5, 0, 0], [0, 0, -9]],
            [[1, 0, 0], [1, 0, 0], [1, 0, 0], [1, -0.0, 0], [0, 0, 1]],
        ),
        LOWER,
        UPPER,
    )
    assert cut.index.tolist() == [0, 1, 3, 4]
    assert torch.isfinite(cut.near_m).all() and torch.isfinite(cut.far_m).all()


def test_sensor_inside_the_box_starts_at_the_sensor() -> None:
    cut = clip_to_box(rays([[0.2, 0, 0]], [[1, 0, 0]]), LOWER, UPPER)
    assert cut.near_m.tolist() == [0.0]
    assert np.isclose(cut.far_m.item(), 0.8)


def test_return_in_front_of_the_box_and_box_behind_the_sensor_are_culled() -> None:
    assert len(clip_to_box(rays([[-5, 0, 0]], [[1, 0, 0]], far=3.9), LOWER, UPPER)) == 0
    assert len(clip_to_box(rays([[5, 0, 0]], [[1, 0, 0]]), LOWER, UPPER)) == 0


def test_beams_near_agrees_with_samples_along_every_beam() -> None:
    points, origin = ground_scan(rings=16, columns=90)
    beams = Beams.from_arrays(points, origin)
    centre, radius = torch.tensor([12.0, 5.0, -1.0]), 3.0
    share = torch.linspace(0, 1, 4000).double()
    on_beam = beams.directions[:, None] * (beams.ranges_m[:, None] * share)[..., None]
    closest = (on_beam - centre).norm(dim=-1).amin(1)
    found = torch.zeros(len(beams), dtype=torch.bool)
    found[beams_near(beams, centre, radius)] = True
    decided = (closest - radius).abs() > 0.02
    assert torch.equal(found[decided], (closest < radius)[decided])
    assert found.sum() > 30


def test_beams_near_is_the_same_for_own_and_shared_origins() -> None:
    points, origin = ground_scan(rings=16, columns=90)
    shared = Beams.from_arrays(points, origin)
    own = Beams.from_arrays(points, np.tile(origin, (len(points), 1)))
    centre = torch.tensor([12.0, 5.0, -1.0])
    assert torch.equal(beams_near(shared, centre, 7.0), beams_near(own, centre, 7.0))


def test_object_rays_by_hand() -> None:
    # An object at (10, 0, 0) turned left by 90 degrees sees the sensor on its left, at +y.
    beams = Beams.from_arrays(np.array([[20.0, 0.0, 0.0]]), np.zeros(3))
    theta = torch.tensor([10.0, 0, 0, torch.pi / 2, 0, 0], dtype=torch.float64)
    ray = object_rays(beams, torch.tensor([0]), theta)
    assert torch.allclose(ray.origins[0], torch.tensor([0.0, 10.0, 0.0]).double(), atol=1e-12)
    assert torch.allclose(ray.directions[0], torch.tensor([0.0, -1.0, 0.0]).double(), atol=1e-12)
