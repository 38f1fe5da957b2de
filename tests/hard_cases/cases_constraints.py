"""Hard cases of the constraints and of placement: limits met exactly, no ground, NaN."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, box, ground_scan, in_frame, soft_car, sphere, union
from catalogue import hard_case
from hard_scenes import PLAIN, beams_along_x, draw, pose
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.pose import PoseLimits, snap_pose
from shift3d.attack.problem import AttackProblem
from shift3d.geometry.se3 import object_from_scene
from shift3d.placement.constraints import ConstraintCheck, Constraints, check, is_clear, snap_to_ground
from shift3d.placement.ground import fit_ground
from shift3d.placement.sampling import NoPlacement, Placement, PlacementContext, PlacementLimits, format_refusals, place
from shift3d.render import Beams, preset
from shift3d.render.field.object_field import ObjectField

AREA = "constraints"
FRAME = Frame((4.0, 1.8, 1.4))
SETTINGS = preset("standard").with_(dtype=torch.float64, sdf_grid=False)
CODE = torch.zeros(6, dtype=torch.float64)
LOW = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
EXACT = Constraints(overlap_m=2.0**-6, contact_m=2.0**-6)  # distances to these limits are exact in floating point


def held(field: Field, *points: tuple[float, float, float], limits: Constraints = EXACT) -> ConstraintCheck:
    """Check an object of 4 x 1.8 x 1.5 m at the origin against scene points."""
    size, pose = torch.tensor([4.0, 1.8, 1.5], dtype=torch.float64), torch.zeros(6, dtype=torch.float64)
    metric = ObjectField.of(field, FRAME, torch.float64, 4096)
    return check(metric, torch.tensor(points, dtype=torch.float64).reshape(-1, 3), pose, size, 300, limits)


CRATE = box((2.0, 0.9, 0.75))


@hard_case(
    area=AREA,
    why="the limit itself is either contact or none",
    must="a ground point at exactly the limit is contact, one a rounding farther is not",
    guard="the comparison with contact_m includes it",
)
def contact_at_exactly_the_tolerance() -> None:
    for limits in (EXACT, Constraints(contact_m=0.5)):
        heights = -0.75 - limits.contact_m, np.nextafter(-0.75 - limits.contact_m, -2.0)
        assert [held(CRATE, (0.0, 0.0, z), limits=limits).contact_ok for z in heights] == [True, False]


@hard_case(
    area=AREA,
    why="the limit itself is either overlap or none",
    must="a scene point exactly as deep as the limit is allowed, one a rounding deeper is not",
    guard="the paper forbids a distance less than -eps: the comparison includes the limit",
)
def overlap_at_exactly_the_tolerance() -> None:
    limit = -0.75 + EXACT.overlap_m
    assert held(CRATE, (0.0, 0.0, limit)).overlap_ok
    assert not held(CRATE, (0.0, 0.0, np.nextafter(limit, 0.0))).overlap_ok


@hard_case(
    area=AREA,
    why="a wall a centimetre from the bumper is near the surface, and nothing is under the wheels",
    must="no contact: a wall carries nothing",
    guard="only points under the object count as contact",
)
def contact_with_a_wall_is_none() -> None:
    wall = [(2.01, y, z) for y in (-0.5, 0.0, 0.5) for z in (-0.7, -0.2, 0.4)]
    assert not held(CRATE, *wall).contact_ok
    assert not held(CRATE, *wall, (0.0, 0.0, -1.0)).contact_ok, "the ground is 25 cm below"
    assert held(CRATE, *wall, (1.0, 0.5, -0.755)).contact_ok


@hard_case(
    area=AREA,
    why="a shape under attack grows a boom over half a metre beyond its baseline's box, into a post",
    must="overlap",
    guard="points near the verified box of the shape count, not only those near its baseline's box",
)
def overlap_beyond_the_baselines_box() -> None:
    grown = union(CRATE, box((0.35, 0.2, 0.2), (2.2, 0.0, 0.0)))
    beams, theta = beams_along_x(y=0.0), pose(10.0)
    rendering = draw(beams, grown, theta, frame=PLAIN)
    metric = ObjectField.of(in_frame(grown, PLAIN), PLAIN, torch.float64, 4096)
    post = torch.tensor([[12.45, 0.0, 0.0]], dtype=torch.float64)
    size = torch.tensor([4.0, 1.8, 1.5], dtype=torch.float64)
    assert rendering.box is not None and float(rendering.box.upper[0]) >= 2.55
    assert not check(metric, post, theta, size, 300, EXACT, box=rendering.box).overlap_ok
    assert check(metric, post, theta, size, 300, EXACT).overlap_ok, "the baseline's box alone does not reach it"


@hard_case(
    area=AREA,
    why="a distance that is no number is not too deep, and not too far",
    must="the object is not valid: neither overlap nor contact holds",
    guard="constraints ask for what must be so, which a NaN never is",
)
def a_field_without_a_number_at_a_scene_point() -> None:
    def field(x: Tensor) -> Tensor:
        return torch.where(x[:, 0] > 1.0, math.nan, CRATE(x))

    assert held(field, (0.0, 0.0, -0.75)).valid
    broken = held(field, (0.0, 0.0, -0.75), (1.5, 0.0, -0.75))
    assert not (broken.overlap_ok or broken.contact_ok or broken.valid)


@hard_case(
    area=AREA,
    why="no scene point lies within reach, so that nothing is inside the object and a minimum has no value",
    must="it hangs in the air or lies underground: no overlap, but no contact either, and so not valid",
    guard="the nearest of no points is infinitely far",
)
def an_object_wholly_under_the_ground() -> None:
    ground = [(float(x), float(y), 3.0) for x in range(-4, 5) for y in range(-4, 5)]
    for points in (ground, []):
        found = held(CRATE, *points)
        assert found.overlap_ok and not found.contact_ok and not found.valid
        assert found.deepest_m == found.nearest_m == math.inf


@hard_case(
    area=AREA,
    why="it could be lifted out step by step, to a place other than the requested one",
    must="no pose is found beyond the reach, one within it is found",
    guard="the change of height is held against the reach at every step",
)
def an_object_sunk_deeper_than_it_may_climb() -> None:
    metric = ObjectField.of(CRATE, FRAME, torch.float64, 4096)
    xy = torch.cartesian_prod(torch.linspace(-3, 3, 25), torch.linspace(-3, 3, 25)).double()
    ground = torch.cat((xy, torch.zeros(len(xy), 1, dtype=torch.float64)), dim=1)
    size = torch.tensor([4.0, 1.8, 1.5], dtype=torch.float64)
    for depth, reach in ((0.6, 0.3), (0.31, 0.3), (0.07, 0.06)):
        sunk = torch.tensor([0.0, 0.0, 0.75 - depth, 0.0, 0.0, 0.0], dtype=torch.float64)
        assert snap_to_ground(metric, ground, sunk, size, reach_m=reach) is None
        out = snap_to_ground(metric, ground, sunk, size, reach_m=0.8)
        assert out is not None and abs(float(out[2]) - 0.75) <= 0.004


@hard_case(
    area=AREA,
    why="lowering the object by its clearance closes a fifth of it there: after eight rounds it still hung in the air, "
    "and a step of an attack counted as impossible",
    must="it comes to rest, touching within 4 mm",
    guard="the few lowest points are followed until they touch",
)
def a_point_beside_a_steep_flank() -> None:
    ball = ObjectField.of(in_frame(sphere(1.0), FRAME), FRAME, torch.float64, 4096)
    size = torch.tensor([2.0, 2.0, 2.0], dtype=torch.float64)
    for range_m, down in ((1.03, 0.3), (1.02, 0.22)):
        point = range_m * torch.tensor([[math.sqrt(1.0 - down**2), 0.0, -down]], dtype=torch.float64)
        found = snap_to_ground(ball, point, torch.zeros(6, dtype=torch.float64), size, reach_m=0.4)
        assert found is not None and found[2] < -0.05
        assert abs(float((point - found[:3]).norm()) - 1.0) <= 0.004


@hard_case(
    area=AREA,
    why="there is nothing to stand on, or the field says nothing there",
    must="no pose, not a NaN one",
    guard="snapping to the ground ends where no scene point is in reach",
)
def nothing_to_snap_to() -> None:
    size = torch.tensor([4.0, 1.8, 1.5], dtype=torch.float64)
    pose = torch.zeros(6, dtype=torch.float64)
    crate = ObjectField.of(CRATE, FRAME, torch.float64, 4096)
    broken = ObjectField.of(lambda x: torch.full_like(x[:, 0], math.nan), FRAME, torch.float64, 4096)
    assert snap_to_ground(crate, torch.zeros(0, 3, dtype=torch.float64), pose, size) is None
    assert snap_to_ground(broken, torch.tensor([[0.0, 0.0, -0.75]], dtype=torch.float64), pose, size) is None


@hard_case(
    area=AREA,
    why="returns along one line leave the slope across it open: least squares makes one up, of noise",
    must="no plane, whatever the direction of the line",
    guard="the returns must spread by a metre across the direction in which they spread most",
)
def ground_seen_along_one_scan_line() -> None:
    rng = np.random.default_rng(0)
    for azimuth in np.radians([0.0, 15.0, 45.0, 80.0]):
        along = azimuth + np.linspace(-0.09, 0.09, 60)
        ring = np.column_stack((30 * np.cos(along), 30 * np.sin(along), -1.73 + rng.normal(0, 0.015, 60)))
        centre = (30 * math.cos(azimuth), 30 * math.sin(azimuth))
        assert fit_ground(ring, centre, -1.73, 2.9) is None
        wide = np.concatenate([ring * np.array([share, share, 1.0]) for share in (0.95, 1.0, 1.05)])
        plane = fit_ground(wide, centre, -1.73, 2.9)
        assert plane is not None and math.hypot(plane.slope_x, plane.slope_y) < 0.02


@hard_case(
    area=AREA,
    why="between two scan lines there is no point: tilted, a vehicle comes to rest with its nose there, below the road",
    must="it rests at most 5 cm below the ground's plane, and a pose that is deeper overlaps the scene",
    guard="points of the plane, lowered by attack.below_ground_m, count as scene points",
)
def the_road_between_two_scan_lines() -> None:
    beams = Beams.from_arrays(*ground_scan(rings=16, columns=900))
    start = torch.tensor([12.6, 0.0, -1.73 + 0.7, 0.0, 0.0, 0.0], dtype=torch.float64)
    only_points = AttackProblem(
        beams, -1.73, lambda code: in_frame(soft_car(code), LOW), LOW, WaveDetector(), start, CODE, settings=SETTINGS
    )
    with_ground = replace(only_points, below_ground_m=0.05)
    metric = only_points.metric(CODE)

    def depth_m(theta: Tensor) -> float:
        grid = (torch.arange(9.5, 15.7, 0.1), torch.arange(-1.2, 1.3, 0.1), torch.arange(-2.3, -1.73, 0.01))
        points = torch.stack(torch.meshgrid(*grid, indexing="ij"), dim=-1).reshape(-1, 3).double()
        inside = metric(object_from_scene(points, theta)) < 0
        return -1.73 - float(points[inside, 2].min()) if bool(inside.any()) else 0.0

    def held_by(problem: AttackProblem, theta: Tensor) -> ConstraintCheck:
        return check(metric, problem.obstacles_at(theta), theta, problem.size_m, 300, problem.limits)

    tilted = start + torch.tensor([0.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    sunk, on_road = (snap_pose(tilted, problem, metric, PoseLimits()) for problem in (only_points, with_ground))
    assert depth_m(sunk) > 0.1 and 0.02 < depth_m(on_road) < 0.07
    assert held_by(only_points, sunk).valid and not held_by(with_ground, sunk).overlap_ok
    assert held_by(with_ground, on_road).valid
    off_ground = start + torch.tensor([40.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # no ground near: returns alone decide
    for theta in (off_ground, torch.full_like(start, torch.nan)):
        assert torch.equal(with_ground.obstacles_at(theta), with_ground.points_near())


@hard_case(
    area=AREA,
    why="a post stands where a vehicle moves to: nothing within 30 cm carries it, and the step has changed its height",
    must="it stands on the ground there, in the post, and overlaps the scene; it is neither buried nor in the air",
    guard="without a rest in reach the height is the ground plane's, not the step's",
)
def a_pose_with_no_rest_in_reach() -> None:
    points, origin = ground_scan(rings=48, columns=900)
    post = np.array([(12.6, 0.0, z) for z in np.linspace(-1.7, 0.6, 24)], dtype=np.float32)
    start = torch.tensor([12.6, 4.0, -1.73 + 0.7, 0.0, 0.0, 0.0], dtype=torch.float64)
    beams = Beams.from_arrays(np.concatenate((points, post)), origin)
    problem = AttackProblem(
        beams, -1.73, lambda code: in_frame(soft_car(code), LOW), LOW, WaveDetector(), start, CODE, settings=SETTINGS
    )
    metric = problem.metric(CODE)
    for height_m in (-1.5, 0.0, 2.0):
        moved = start + torch.tensor([0.0, -4.0, height_m, 0.3, 0.0, 0.0])
        rests = snap_pose(moved, problem, metric, PoseLimits())
        assert abs(float(rests[2] - start[2])) < 0.1 and torch.equal(rests[[0, 1, 3, 4, 5]], moved[[0, 1, 3, 4, 5]])
        assert not check(metric, problem.obstacles_at(rests), rests, problem.size_m, 300, problem.limits).overlap_ok


@hard_case(
    area=AREA,
    why="a scene may have no ground at all, and a quantile of no heights has no value",
    must="no placement, and the reason why",
    guard="a place with too few returns near the ground's height is turned down first",
)
def a_scene_without_room_for_the_object() -> None:
    angle = np.linspace(-np.pi, np.pi, 2000)
    wall = np.stack((30 * np.cos(angle), 30 * np.sin(angle), np.full_like(angle, 2.0)), axis=1).astype(np.float32)
    beams = Beams.from_arrays(wall, np.zeros(3, np.float32))
    limits = PlacementLimits(8.0, 12.0, attempts=7)
    found = place(
        PlacementContext(beams, -1.73), soft_car(CODE), FRAME, np.random.default_rng(0), limits, settings=SETTINGS
    )
    assert isinstance(found, NoPlacement) and found.rejected == {"ground": 7}
    assert found.attempts == 7 and format_refusals(found.rejected) == "no ground seen 7"


@hard_case(
    area=AREA,
    why="a neighbour exactly as far as the limit is either too near or not",
    must="it is too near: what is within the limit could be taken for the object",
    guard="the distance must exceed the limit",
)
def a_neighbour_at_exactly_the_clear_distance() -> None:
    here = torch.tensor([10.0, -2.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    at = torch.tensor([[13.0, 2.0]], dtype=torch.float64)  # 3, 4, 5: exact
    assert not is_clear(here, at, 5.0) and is_clear(here, at, math.nextafter(5.0, 0.0))
    assert not is_clear(here, torch.full((1, 2), math.nan), 5.0)  # a neighbour at an unknown place
    assert is_clear(here, None, 5.0) and is_clear(here, at[:0], 5.0)


@hard_case(
    area=AREA,
    why="a bus is drawn in units of 20 m, whose rounding in float32 is above the tolerance that places are rendered to",
    must="it finds the place that it finds in units of 10 m, whatever accuracy the task has",
    guard="a place is rendered to what the dtype can reach on the vehicle",
)
def a_bus_in_units_of_twenty_metres() -> None:
    site = PlacementContext(Beams.from_arrays(*ground_scan(rings=64)), -1.73)
    places = []
    for scale_m in (10.0, 17.0, 20.0):
        frame = Frame((18.0, 2.5, 3.2), scale_m)
        field, rng = in_frame(box((9.0, 1.25, 1.6)), frame), np.random.default_rng(0)
        found = place(site, field, frame, rng, PlacementLimits(12.0, 25.0), Constraints(min_object_points=50))
        assert isinstance(found, Placement)
        places.append((found.theta, found.check.object_points))
    assert all(torch.allclose(theta, places[0][0], atol=1e-4) for theta, _ in places)
    assert len({count for _, count in places}) == 1
