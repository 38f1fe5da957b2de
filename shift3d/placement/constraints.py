"""Constraints on an inserted object: it overlaps nothing, touches the ground and gets enough points."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene, scene_from_object
from shift3d.render.beams import Beams
from shift3d.render.culling import Box
from shift3d.render.field.object_field import ObjectField

_TOUCHING_M = 0.004
# Largest number of evaluations of all points, number of lowest points to iterate on, and iterations on those points.
_LOOKS, _FEW, _MOVES = 8, 8, 16


@dataclass(frozen=True)
class Constraints:
    """Limits on an inserted object. A value equal to its limit is allowed, except for clear_m.

    overlap_m: largest depth of an original scene point inside the object. Paper: "we avoid object positions that would
        result in any point in the scene having an SDF value less than -eps_overlap", 0.02.
    contact_m: largest distance from the object's surface to the nearest original scene point under the object. The
        paper's text asks that "at least one point in the original scene has SDF value greater than eps_float", 0.02,
        which any far point satisfies. This limit checks the purpose that the paper gives: "to ensure that the SDF
        object is in contact with the ground".
    min_object_points: least number of returns on the object: "disallowing inserted objects that result in fewer than
        300 on-object points post rendering".
    clear_m: the centre of any other vehicle must be farther away, in the ground plane. The paper counts any box within
        5 m as a detection of the object, so a detected neighbour within 5 m would always count as the object. Our
        choice: the paper is silent.

    Source: SHIFT3D, Realism Constraints on Object Pose and Hyper-parameters.
    """

    overlap_m: float = 0.02
    contact_m: float = 0.02
    min_object_points: int = 300
    clear_m: float = 6.0


PAPER_CONSTRAINTS = Constraints()
"""Values of the paper."""


@dataclass(frozen=True)
class ConstraintCheck:
    """Result of the constraint check of one object.

    deepest_m: smallest metric distance of an original point (negative inside); infinite if no point is near.
    nearest_m: smallest |metric distance| of a point under the object; infinite if no point is near.
    """

    deepest_m: float
    nearest_m: float
    object_points: int
    overlap_ok: bool
    contact_ok: bool
    points_ok: bool
    clear_ok: bool = True

    @property
    def valid(self) -> bool:
        """True if all constraints hold."""
        return self.overlap_ok and self.contact_ok and self.points_ok and self.clear_ok


def points_near(beams: Beams, theta: Tensor, radius_m: float) -> Tensor:
    """Return the original returns (M, 3) float64 within radius_m of the object's centre, scene frame."""
    offset = beams.points - theta[:3].detach().to(beams.points.dtype)
    near = (offset.square().sum(-1) <= radius_m**2) & beams.carries
    return beams.points[near].double()


def object_points_near(
    points: Tensor, theta: Tensor, size_m: Tensor, reach_m: float = 0.3, box: Box | None = None
) -> Tensor:
    """Return the points near the object, converted to the object frame, (M', 3).

    Args:
        points: (M, 3) float64, scene frame. theta: (6,) pose.
        size_m: (3,) size of the baseline's box. reach_m: largest distance of a point from this box, per axis.
        box: bounding box of the object, if known: points near it are returned too, because a shape under attack may
            outgrow its baseline's box.
    """
    x_object = object_from_scene(points, theta.detach().double())
    near = (x_object.abs() <= size_m / 2 + reach_m).all(-1)
    if box is not None:
        around = box.grown(reach_m / 3)
        near |= ((x_object >= around.lower) & (x_object <= around.upper)).all(-1)
    return x_object[near]


def check(
    field: ObjectField,
    points: Tensor,
    theta: Tensor,
    size_m: Tensor,
    object_points: int,
    limits: Constraints,
    others: Tensor | None = None,
    box: Box | None = None,
) -> ConstraintCheck:
    """Check one object against the limits.

    Args:
        field: metric distance in the object frame. points: ORIGINAL returns near the object.
        theta, size_m, box: see `object_points_near`.
        object_points: number of returns on the object after rendering.
        others: (M, 2) centres of other vehicles, scene frame, metres.

    Only points under the object (below its centre, within its baseline's length and width) count as contact, because a
    wall or kerb beside the object does not support it.
    """
    places = object_points_near(points, theta, size_m, max(0.3, limits.contact_m), box)
    with torch.no_grad():
        metric = field(places).double()
    deepest = float(metric.min()) if len(metric) else float("inf")
    under = (places[:, :2].abs() <= size_m[:2] / 2).all(-1) & (places[:, 2] <= 0.0)
    nearest = float(metric[under].abs().min()) if bool(under.any()) else float("inf")
    return ConstraintCheck(
        deepest,
        nearest,
        object_points,
        deepest >= -limits.overlap_m,
        nearest <= limits.contact_m,
        object_points >= limits.min_object_points,
        is_clear(theta, others, limits.clear_m),
    )


def is_clear(theta: Tensor, others: Tensor | None, clear_m: float) -> bool:
    """True if all centres of other vehicles (M, 2) are farther than clear_m from the object's, in the ground plane."""
    if others is None or len(others) == 0:
        return True
    return bool(((others - theta[:2].detach().to(others)).norm(dim=-1) > clear_m).all())


def snap_to_ground(
    field: ObjectField, points: Tensor, theta: Tensor, size_m: Tensor, reach_m: float = 0.3
) -> Tensor | None:
    """Return the pose with z moved until the object just touches the original points; None if z moves too far.

    The distance g is 1-Lipschitz, so lowering the object by its clearance cannot push it through a point: the iteration
    z <- z - min g approaches from above, and raises an object that is inside. It runs on the few lowest points, then
    checks all points once those touch. reach_m: largest change of z.

    Source: our choice: the paper places with a six-dof pose and leaves the method open.
    """
    snapped = theta.detach().double().clone()
    for _ in range(_LOOKS):
        places = object_points_near(points, snapped, size_m, reach_m)
        if len(places) == 0:
            return None
        with torch.no_grad():
            metric = field.estimate(places).double()  # exact near the surface and inside, where it decides
        if abs(float(metric.min())) <= _TOUCHING_M:
            return snapped
        few, clearance = scene_from_object(places[metric.argsort(stable=True)[:_FEW]], snapped), float(metric.min())
        for _ in range(_MOVES):
            snapped[2] -= clearance
            if not abs(float(snapped[2] - theta[2])) <= reach_m:
                return None
            with torch.no_grad():
                clearance = float(field(object_from_scene(few, snapped)).min())
            if abs(clearance) <= _TOUCHING_M / 2:
                break
    return None
