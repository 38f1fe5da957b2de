"""Verified bounding box: a box around the zero level set that is checked with field evaluations."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.render.culling import Box
from shift3d.render.field.object_field import ObjectField

SDF_RADIUS = 1.05
"""Radius of the ball, sdf units, in which a DeepSDF decoder has been trained; shapes lie in the unit ball."""
_CELL_M = 0.45
_LEVELS = 3
_STEEPEST = 1.11
_GROWS_M = 0.2
_ROUNDS = 6
_LOOK_AGAIN_M = 0.005


def sdf_ball_box(field: ObjectField) -> Box:
    """Return the bounding box of the ball in which the decoder was trained; no part of a shape can lie outside."""
    centre = -(field.sdf_t_object @ field.sdf_R_object) * field.scale_m
    radius = SDF_RADIUS * field.scale_m
    return Box(centre - radius, centre + radius)


def verified_box(field: ObjectField, size_m: Tensor, margin_m: float) -> VerifiedBox:
    """Compute the verified bounding box: the vehicle's box plus a margin, grown until no check point is inside.

    A shape under attack can outgrow the box of its baseline. The check covers the part of the decoder's ball outside
    the box with cells of 0.45 m. A cell is divided, down to 0.11 m, if g at its centre does not prove the cell free up
    to its corners. Every part with a radius of 0.1 m or more is found, attached to the body or not. A field that is
    negative everywhere gives the ball's own box. A NaN counts as inside, so that the beams that meet it are evaluated
    and counted.

    Args:
        field: metric distance in the object frame. margin_m: growth of each face.
        size_m: (3,) size of the baseline's box, centred at the object's origin.
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
        lower = torch.minimum(box.lower, inside.amin(0) - reach)
        upper = torch.maximum(box.upper, inside.amax(0) + reach)
        box = Box(torch.maximum(lower, ball.lower), torch.minimum(upper, ball.upper))
    nothing = torch.empty(0, dtype=torch.float64)
    return VerifiedBox(ball, nothing.reshape(0, 3), nothing, nothing)


def _check_points(field: ObjectField, box: Box, ball: Box) -> tuple[Tensor, Tensor]:
    """Evaluate octree cells outside a box. Returns their centres (P, 3) and g (P,) at the centres.

    The octree has three levels; the search stops at the first level that has a centre inside the object.
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
        # A cell that a face of the box cuts is evaluated on the face, so that a panel is noticed as soon as it passes.
        on_face = ((points - size_m / 2 <= box.upper) & (points + size_m / 2 >= box.lower)).all(-1, keepdim=True)
        points = torch.where(on_face, _onto_faces(points, box), points)
        g = field.estimate(points).double()
        found.append((points, g))
        if bool((~(g > 0)).any()):
            break  # the box grows, and every cell is checked again
        near = ~(g > _STEEPEST * size_m * 3**0.5 / 2) & (g > 0)
        octants = torch.cartesian_prod(*[torch.tensor([-0.25, 0.25], dtype=torch.float64)] * 3) * size_m
        points, size_m = (points[near][:, None] + octants).reshape(-1, 3), size_m / 2
    check, g = (torch.cat(parts) for parts in zip(*found))
    return check, g


def _onto_faces(points: Tensor, box: Box) -> Tensor:
    """Move each point (P, 3) to the nearest place on the faces of the box."""
    inside = ((points > box.lower) & (points < box.upper)).all(-1)
    below, above = points - box.lower, box.upper - points
    _, axis = torch.minimum(below, above).min(-1)
    rows = torch.arange(len(points))
    end = torch.where(below[rows, axis] < above[rows, axis], box.lower[axis], box.upper[axis])
    moved = torch.minimum(torch.maximum(points, box.lower), box.upper)
    return torch.where(inside[:, None], points.index_put((rows, axis), end), moved)


@dataclass(frozen=True)
class VerifiedBox:
    """A checked box with its check points (P, 3).

    g: (P,) field values at the check points. moved_m: (P,) most that the surface can have moved since each was
    evaluated.
    """

    box: Box
    points: Tensor
    g: Tensor
    moved_m: Tensor

    @property
    def holds(self) -> bool:
        """True if no check point is inside the object, so that no part has left the box. A NaN counts as inside."""
        return bool((self.g > 0).all())

    def after(self, field: ObjectField, moved_m: float) -> VerifiedBox:
        """Check again after the surface moved by up to `moved_m`; evaluates only check points that the surface can
        reach."""
        moved = self.moved_m + moved_m
        near = torch.nonzero(~(self.g > moved + _LOOK_AGAIN_M)).squeeze(1)
        g = self.g.index_copy(0, near, field.estimate(self.points[near]).double())
        return VerifiedBox(self.box, self.points, g, moved.index_fill(0, near, 0.0))
