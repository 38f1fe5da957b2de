"""A box around the zero level set that is checked, not assumed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.render.culling import Box
from shift3d.render.field.object_field import ObjectField

SDF_RADIUS = 1.05
"""Radius of the ball, sdf units, in which a DeepSDF decoder has been trained: shapes lie in the unit ball."""
_CELL_M = 0.45
_LEVELS = 3
_STEEPEST = 1.11
_GROWS_M = 0.2
_ROUNDS = 6
_LOOK_AGAIN_M = 0.005


def sdf_ball_box(field: ObjectField) -> Box:
    """The box around the ball in which the decoder was trained: nothing of a shape can lie outside."""
    centre = -(field.sdf_t_object @ field.sdf_R_object) * field.scale_m
    radius = SDF_RADIUS * field.scale_m
    return Box(centre - radius, centre + radius)


def verified_box(field: ObjectField, size_m: Tensor, margin_m: float) -> VerifiedBox:
    """The vehicle's box grown by a margin and, where the field is inside at a check point, further.

    A shape under attack can outgrow the box of its baseline. Checked is what of the decoder's ball lies outside the
    box: cells of 0.45 m; a cell whose centre has less free space than its corners are away is divided, down to 0.11 m.
    A part with a radius of 0.1 m or more is found, whether it floats free or sticks out. A field that is inside all
    over ends at the ball's own box. A NaN counts as inside, so that the beams that meet it are looked at and counted.

    Args:
        field: metric distance in the object frame.
        size_m: (3,) size of the baseline's box, centred at the object's origin.
        margin_m: growth of each face.

    Source: our choice: the paper is silent.
    """
    ball = sdf_ball_box(field)
    half = torch.as_tensor(size_m, dtype=torch.float64) / 2
    box = Box(torch.maximum(-half - margin_m, ball.lower), torch.minimum(half + margin_m, ball.upper))
    for _ in range(_ROUNDS):
        check, g = _check_points(field, box, ball)
        inside = check[~(g > 0)]
        if len(inside) == 0:
            return VerifiedBox(box, check, g, torch.zeros_like(g))
        reach = _GROWS_M + margin_m
        lower, upper = (
            torch.minimum(box.lower, inside.amin(0) - reach),
            torch.maximum(box.upper, inside.amax(0) + reach),
        )
        box = Box(torch.maximum(lower, ball.lower), torch.minimum(upper, ball.upper))
    nothing = torch.empty(0, dtype=torch.float64)
    return VerifiedBox(ball, nothing.reshape(0, 3), nothing, nothing)


def _check_points(field: ObjectField, box: Box, ball: Box) -> tuple[Tensor, Tensor]:
    """Centres (P, 3) of the cells outside a box that were looked at, and g (P,) there.

    An octree of three levels, or of those up to the first at which something lies inside the object.
    """
    centre, radius = (ball.lower + ball.upper) / 2, (ball.upper - ball.lower)[0] / 2
    axes = [
        torch.arange(float(a), float(b) + _CELL_M, _CELL_M, dtype=torch.float64) for a, b in zip(ball.lower, ball.upper)
    ]
    points, size_m = torch.cartesian_prod(*axes), _CELL_M
    found = []
    for _ in range(_LEVELS):
        outside = ((points - size_m / 2 < box.lower) | (points + size_m / 2 > box.upper)).any(-1)
        points = points[outside & ((points - centre).norm(dim=-1) <= radius + size_m / 2)]
        # A cell on a face is asked there, so that a panel is noticed in the step that takes it through the face.
        on_face = ((points - size_m / 2 <= box.upper) & (points + size_m / 2 >= box.lower)).all(-1, keepdim=True)
        points = torch.where(on_face, _onto_faces(points, box), points)
        g = field.estimate(points).double()
        found.append((points, g))
        if bool((~(g > 0)).any()):
            break  # the box grows, and all is looked at again
        near = ~(g > _STEEPEST * size_m * 3**0.5 / 2) & (g > 0)
        octants = torch.cartesian_prod(*[torch.tensor([-0.25, 0.25], dtype=torch.float64)] * 3) * size_m
        points, size_m = (points[near][:, None] + octants).reshape(-1, 3), size_m / 2
    check, g = (torch.cat(parts) for parts in zip(*found))
    return check, g


def _onto_faces(points: Tensor, box: Box) -> Tensor:
    """Points (P, 3), each moved to the nearest place on the box's faces."""
    inside = ((points > box.lower) & (points < box.upper)).all(-1)
    below, above = points - box.lower, box.upper - points
    _, axis = torch.minimum(below, above).min(-1)
    rows = torch.arange(len(points))
    end = torch.where(below[rows, axis] < above[rows, axis], box.lower[axis], box.upper[axis])
    moved = torch.minimum(torch.maximum(points, box.lower), box.upper)
    return torch.where(inside[:, None], points.index_put((rows, axis), end), moved)


@dataclass(frozen=True)
class VerifiedBox:
    """A checked box and the places (P, 3) where it was checked.

    g: (P,) distances found there. moved_m: (P,) how far the surface may have moved since each was looked at.
    """

    box: Box
    points: Tensor
    g: Tensor
    moved_m: Tensor

    @property
    def holds(self) -> bool:
        """Whether nothing was found to have left the box. A NaN counts as having left."""
        return bool((self.g > 0).all())

    def after(self, field: ObjectField, moved_m: float) -> VerifiedBox:
        """The box after the surface moved by up to `moved_m`: places that it can have come near are looked at again."""
        moved = self.moved_m + moved_m
        near = torch.nonzero(~(self.g > moved + _LOOK_AGAIN_M)).squeeze(1)
        g = self.g.index_copy(0, near, field.estimate(self.points[near]).double())
        return VerifiedBox(self.box, self.points, g, moved.index_fill(0, near, 0.0))
