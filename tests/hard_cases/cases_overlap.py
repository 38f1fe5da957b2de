"""Hard cases of oriented boxes and their overlap."""

from __future__ import annotations

import math

import numpy as np
from catalogue import hard_case

from shift3d.errors import InputError
from shift3d.geometry.boxes import validate_boxes
from shift3d.geometry.iou import iou_3d, iou_bev

AREA = "loss and IoU"


def box(x: float, y: float, dx: float, dy: float, heading: float = 0.0, dz: float = 1.0) -> np.ndarray:
    return np.array([[x, y, 0.0, dx, dy, dz, heading]])


@hard_case(
    area=AREA,
    why="intersection and union are both 0, and 0/0 is NaN",
    must="boxes without area overlap nothing: 0, with each other and with themselves",
    guard="the quotient is taken only where the union is positive",
)
def two_footprints_without_area() -> None:
    for flat in (box(3.0, 1.0, 0.0, 0.0), box(3.0, 1.0, 4.0, 0.0, 0.7)):
        for other in (flat, box(3.0, 1.0, 0.0, 2.0), box(3.0, 1.0, 4.0, 2.0, 0.2)):
            assert iou_bev(flat, other)[0, 0] == iou_bev(other, flat)[0, 0] == 0.0


@hard_case(
    area=AREA,
    why="footprints overlap, but neither box has a volume",
    must="the overlap of volumes is 0, not NaN",
    guard="the quotient of volumes is taken only where the union is positive",
)
def two_boxes_without_height() -> None:
    sheet = box(0.0, 0.0, 4.0, 2.0, dz=0.0)
    assert iou_3d(sheet, sheet)[0, 0] == 0.0 and iou_bev(sheet, sheet)[0, 0] == 1.0


@hard_case(
    area=AREA,
    why="an edge that lies on a line of the other box crosses it nowhere or everywhere: 0/0",
    must="identical boxes overlap by 1, boxes that share some sides by the ratio of their areas",
    guard="crossings without a number become a place on the edge, where they change no area",
)
def boxes_with_sides_on_one_line() -> None:
    for heading in (0.0, math.pi / 2, 0.3):
        whole = box(5.0, -2.0, 4.0, 2.0, heading)
        assert abs(iou_bev(whole, whole)[0, 0] - 1.0) < 1e-12
    whole, half, quarter = box(0, 0, 4.0, 2.0), box(1.0, 0, 2.0, 2.0), box(1.0, 0.5, 2.0, 1.0)
    assert iou_bev(whole, half)[0, 0] == 0.5 and iou_bev(whole, quarter)[0, 0] == 0.25
    assert iou_bev(half, box(0.0, 0.0, 2.0, 2.0))[0, 0] == 1.0 / 3.0


@hard_case(
    area=AREA,
    why="sides that are turned by a rounding cross where the quotient of two roundings says",
    must="a box turned by t about its middle overlaps itself by 1 - t (a^2 + b^2) / 2ab, down to the last digit",
    guard="a crossing that is off along a nearly parallel side changes the area by its angle to it alone",
)
def boxes_turned_by_the_smallest_angles() -> None:
    for length, width in ((4.1, 1.9), (1.9, 4.1), (40.0, 0.5)):
        for heading in (0.0, 0.3, math.pi / 2, -3.1):
            whole = box(61.7, -33.3, length, width, heading)
            for turn in (1e-16, 1e-14, 1e-12, 1e-9, 1e-6):
                other = box(61.7, -33.3, length, width, heading + turn)
                turned = abs(other[0, 6] - heading) * (length**2 + width**2) / (2 * length * width)
                for found in (iou_bev(whole, other)[0, 0], iou_bev(other, whole)[0, 0]):
                    assert abs(found - (1.0 - turned)) < 2.0 * turned**2 + 1e-14


@hard_case(
    area=AREA,
    why="every edge is crossed twice, at places whose order depends on the edge's direction",
    must="two squares at 45 degrees meet in the regular octagon, of area 2 (sqrt 2 - 1)",
    guard="the crossings of an edge are sorted along it",
)
def every_edge_crossed_twice() -> None:
    octagon = 2.0 * (math.sqrt(2.0) - 1.0)
    for turn in (0.0, 0.4, 2.0):
        found = iou_bev(box(7.0, 7.0, 1.0, 1.0, turn), box(7.0, 7.0, 1.0, 1.0, turn + math.pi / 4))[0, 0]
        assert abs(found - octagon / (2.0 - octagon)) < 1e-12


@hard_case(
    area=AREA,
    why="the outline of a box that is moved onto the other's border encloses a rounding error, not nothing",
    must="boxes a micrometre apart overlap by exactly 0, so that such a proposal is none of the loss's",
    guard="where an axis separates two boxes no area is computed",
)
def boxes_a_micrometre_apart() -> None:
    for heading in np.linspace(-3.0, 3.0, 40):
        along = np.array([math.cos(heading), math.sin(heading)])
        for turn in (0.0, math.pi / 2, math.pi):
            reach = 2.05 + (2.05 if turn != math.pi / 2 else 0.95) + 1e-6
            other = box(*(np.array([1.0, 2.0]) + reach * along), 4.1, 1.9, heading + turn)
            assert iou_bev(box(1.0, 2.0, 4.1, 1.9, heading), other)[0, 0] == 0.0


@hard_case(
    area=AREA,
    why="at 20 km a coordinate's last digit is 4e-12 m, and turned coordinates of each box lose it",
    must="the same overlap to the bit as at the origin",
    guard="the difference of the centres is taken first, and turned into a box's frame then",
)
def boxes_twenty_kilometres_away() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        offset = np.round(rng.uniform(-2, 2, 2) * 64) / 64  # exact at 20 km, too
        near = box(0.0, 0.0, 4.0, 2.0, rng.uniform(-3, 3)), box(*offset, 4.2, 1.9, rng.uniform(-3, 3))
        far = [one + np.array([20000.0, -16384.0, 0, 0, 0, 0, 0]) for one in near]
        assert iou_bev(*far)[0, 0] == iou_bev(*near)[0, 0]


@hard_case(
    area=AREA,
    why="the detector's box may be 700 m long, and holds the object or is held by it",
    must="the overlap of a box inside another is the ratio of the areas",
    guard="what lies outside is moved onto the border, where it encloses nothing",
)
def a_box_inside_one_of_seven_hundred_metres() -> None:
    huge, car = box(30.0, 10.0, 702.0, 309.0, 1.1), box(31.0, 9.0, 4.0, 2.0, -0.4)
    wanted = 8.0 / (702.0 * 309.0)
    for found in (iou_bev(huge, car)[0, 0], iou_bev(car, huge)[0, 0]):
        assert abs(found - wanted) < 1e-9 * wanted


@hard_case(
    area=AREA,
    why="a NaN compares false, so that a size that is not negative is not yet a positive one",
    must="a box without a size, or with none that is a number, is refused by its row and column",
    guard="sizes must be positive, which a NaN is not",
)
def a_label_with_no_width() -> None:
    good = box(1.0, 2.0, 4.0, 2.0)
    validate_boxes(good, "labels")
    for width in (0.0, -2.0, math.nan, math.inf):
        try:
            validate_boxes(np.concatenate((good, box(1.0, 2.0, 4.0, width))), "labels")
        except InputError as error:
            assert "box 1 has dy" in str(error)
        else:
            raise AssertionError(f"a box {width} m wide was taken")
