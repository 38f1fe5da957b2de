"""The checked box holds the shape, also a shape that has outgrown its baseline."""

import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Frame, box, car, in_frame, rounded, sphere, union

from shift3d.render.culling import Box
from shift3d.render.field.bounding_box import sdf_ball_box, verified_box
from shift3d.render.field.object_field import ObjectField

# The decoder's ball has radius 1.05 units: with 2.5 m per unit a car fits.
SIZE = torch.tensor(SHAPENET_FRAME.size_m).double()


def box_of(metric, margin: float = 0.1) -> tuple[Box, ObjectField]:  # type: ignore[no-untyped-def]
    field = ObjectField.of(in_frame(metric, SHAPENET_FRAME), SHAPENET_FRAME, torch.float64, 4096)
    return verified_box(field, SIZE, margin).box, field


def test_a_shape_within_its_baseline_gets_the_grown_baseline_box() -> None:
    found, field = box_of(car())
    assert torch.allclose(found.upper, SIZE / 2 + 0.1) and torch.allclose(found.lower, -SIZE / 2 - 0.1)
    assert field.count.evaluations < 6000


@pytest.mark.parametrize(
    "metric",
    [
        rounded(car(), 0.25),
        union(car(), box((0.3, 0.3, 0.3), (0.0, 0.0, 1.0))),
        union(car(), box((0.15, 0.9, 0.15), (0.8, 1.0, 0.2))),
        union(car(), sphere(0.3, (0.0, 0.0, 1.9))),
        union(car(), sphere(0.35, (-0.5, -1.8, 0.3))),
    ],
    ids=["inflated", "roof box", "arms", "floating above", "floating beside"],
)
def test_a_shape_that_outgrew_its_baseline_is_inside(metric) -> None:  # type: ignore[no-untyped-def]
    found, _ = box_of(metric)
    lattice = torch.cartesian_prod(*[torch.linspace(-2.4, 2.4, 60).double()] * 3)
    lattice = lattice[lattice.norm(dim=-1) < 2.5]
    inside = lattice[metric(lattice) < 0]
    assert ((inside >= found.lower) & (inside <= found.upper)).all()


def test_inside_everywhere_ends_at_the_decoders_ball() -> None:
    found, field = box_of(lambda x: torch.full_like(x[:, 0], -0.1))
    ball = sdf_ball_box(field)
    assert torch.allclose(found.lower, ball.lower) and torch.allclose(found.upper, ball.upper)
    assert torch.allclose(ball.upper - ball.lower, torch.full((3,), 2 * 1.05 * 2.5).double())


def test_nothing_anywhere_keeps_the_baseline_box() -> None:
    found, _ = box_of(lambda x: torch.full_like(x[:, 0], 0.1))
    assert torch.allclose(found.upper, SIZE / 2 + 0.1)


def test_radius_reaches_the_farthest_corner() -> None:
    assert Box(torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([0.5, 1.0, 2.0])).radius_m == 3.0
    assert Frame().scale_m == 1.0


def _roof(height_m: float) -> ObjectField:
    """Return the field below a plane this much above the baseline's roof, but 30 cm above its ground."""
    top = float(SIZE[2]) / 2 + height_m
    lowest = -float(SIZE[2]) / 2 + 0.3

    def metric(x: torch.Tensor) -> torch.Tensor:
        inside = torch.stack([x[:, 2] - top, lowest - x[:, 2], x[:, 0].abs() - 1.0, x[:, 1].abs() - 0.5])
        return inside.amax(0)

    return ObjectField.of(in_frame(metric, SHAPENET_FRAME), SHAPENET_FRAME, torch.float64, 4096)


def test_a_roof_that_rests_and_then_rises_is_noticed_before_it_is_two_centimetres_out() -> None:
    """Other parts move by a centimetre a step all the time; a bound is half as much again."""
    height = -0.05
    verified = verified_box(_roof(height), SIZE, 0.05)
    looks = []
    for step in range(40):
        height += 0.01 if step >= 12 else 0.0
        field = _roof(height)
        after = verified.after(field, 0.015)
        looks.append(field.count.evaluations)
        if not after.holds:
            break
        verified = after
    assert 0.05 < height < 0.07
    assert sum(looks[:12]) < 6 * max(looks), "a roof that rests is not looked at every time"
