"""Hard cases of the files of a KITTI frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from catalogue import hard_case
from clear_errors import place, refused
from valid_frames import CALIBRATION, LABELS, NAME, street, write_frame

from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.scene import Scene

AREA = "scene files"
BIN, TXT = f"velodyne/{NAME}.bin", f"{NAME}.txt"
CAR = LABELS.splitlines()[0]


def load(change: Callable[[Path], object]) -> Scene:
    """Load the small frame after a change of its training/ folder."""
    with place() as root:
        write_frame(root)
        change(root / "training")
        return KittiScenes(root).load(NAME)


def with_points(points: np.ndarray) -> Callable[[Path], object]:
    return lambda folder: (folder / BIN).write_bytes(points.astype("<f4").tobytes())


def with_labels(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "label_2" / TXT).write_text(text)


def with_matrix(key: str, matrix: np.ndarray | None) -> Callable[[Path], object]:
    """Return a change that replaces or removes one line of the calibration."""

    def change(folder: Path) -> None:
        matrices = CALIBRATION | ({key: matrix} if matrix is not None else {})
        lines = [
            f"{k}: {' '.join(map(str, np.ravel(m)))}" for k, m in matrices.items() if k != key or matrix is not None
        ]
        (folder / "calib" / TXT).write_text("\n".join(lines))

    return change


def some_points() -> np.ndarray:
    return street(300)


@hard_case(
    area=AREA,
    why="a copy that ended early ends within a point",
    must="an error that says how many bytes there are",
    guard="the file must be a whole number of 16-byte points",
)
def a_point_file_cut_off_within_a_point() -> None:
    raw = some_points().tobytes()
    for size in (len(raw) - 3, len(raw) - 4, 15):
        refused(lambda size=size: load(lambda folder: (folder / BIN).write_bytes(raw[:size])), BIN, f"{size} bytes")


@hard_case(
    area=AREA,
    why="an empty file is a whole number of points: none",
    must="an error that names the file",
    guard="no bytes are no frame",
)
def a_point_file_without_points() -> None:
    refused(lambda: load(with_points(some_points()[:0])), BIN, "0 bytes")


@hard_case(
    area=AREA,
    why="NaN compares false with every limit, and one NaN makes a whole pillar's features NaN",
    must="an error that names the file and the first row",
    guard="rows are looked through for NaN and infinity where the file is read",
)
def a_point_of_nan_or_infinity() -> None:
    for row, column, value in ((7, 0, np.nan), (0, 2, np.inf), (299, 3, np.nan)):
        points = some_points()
        points[row, column] = value
        refused(lambda points=points: load(with_points(points)), BIN, f"row {row}")


@hard_case(
    area=AREA,
    why="a float64 file or one flipped bit of an exponent gives finite coordinates of 1e30 m, whose squares overflow",
    must="an error that names the file and the row",
    guard="no return is more than 10 km away",
)
def a_return_from_beyond_the_horizon() -> None:
    points = some_points()
    points[11, 1] = -3e30
    refused(lambda: load(with_points(points)), BIN, "row 11")


@hard_case(
    area=AREA,
    why="a return at zero range has no direction",
    must="its row stays where it is, and carries no beam",
    guard="a beam is where point and origin differ",
)
def returns_at_zero_range() -> None:
    points = some_points()
    points[[0, 5, 299], :3] = 0.0
    points[6, :3] = (1e-42, 0.0, 0.0)  # a range near 0, and still a direction
    scene = load(with_points(points))
    assert np.flatnonzero(~scene.has_beam).tolist() == [0, 5, 299]
    assert np.array_equal(scene.points, points[:, :3])


@hard_case(
    area=AREA,
    why="a sensor that saw nothing writes zeros: a frame of the right size without a beam",
    must="an error that names the file",
    guard="some point must lie away from the sensor",
)
def a_frame_of_nothing_but_zero_ranges() -> None:
    refused(lambda: load(with_points(some_points() * (0.0, 0.0, 0.0, 1.0))), BIN, "positive range")


@hard_case(
    area=AREA,
    why="two returns at one place look like a copy of one",
    must="both stay, in the file's order: rows of every other array refer to them",
    guard="points are taken as they stand in the file",
)
def two_returns_at_one_place() -> None:
    points = some_points()
    points[200] = points[17]
    scene = load(with_points(points))
    assert np.array_equal(scene.points, points[:, :3]) and scene.has_beam[[17, 200]].all()


@hard_case(
    area=AREA,
    why="raw intensities exceed 65504, where half precision ends in infinity",
    must="a reflectance of 1",
    guard="reflectance is cut to 0..1 where it is read",
)
def an_intensity_beyond_half_precision() -> None:
    points = some_points()
    points[:3, 3] = (65505.0, 3e38, -1.0)
    reflectance = load(with_points(points)).reflectance
    assert reflectance is not None and reflectance[:3].tolist() == [1.0, 1.0, 0.0]
    assert np.isfinite(reflectance.astype(np.float16)).all()


@hard_case(
    area=AREA,
    why="every column after a missing one means something else",
    must="an error that names the line",
    guard="a label has 15 columns, or 16 with a score",
)
def a_label_with_a_column_missing_or_too_many() -> None:
    for columns in (CAR.split()[:-1], [*CAR.split(), "0.9", "1"], CAR.split()[:1]):
        text = f"{CAR}\n{' '.join(columns)}\n"
        refused(lambda text=text: load(with_labels(text)), f"{TXT}, line 2", f"{len(columns)} column")


@hard_case(
    area=AREA,
    why="'nan' and '1e999' are numbers to Python, and a box of them overlaps with nothing and with everything",
    must="an error that names the line and the word",
    guard="every number of a file must be finite",
)
def a_label_that_says_nan() -> None:
    for column, word in ((14, "nan"), (11, "1e999"), (8, "-inf"), (5, "five")):
        columns = CAR.split()
        columns[column] = word
        text = " ".join(columns)
        refused(lambda text=text: load(with_labels(text)), f"{TXT}, line 1", word)


@hard_case(
    area=AREA,
    why="a class that is not known cannot be scored, and one that is misspelt would be lost without a word",
    must="an error that names the line and the classes there are",
    guard="a class must be one of KITTI's",
)
def a_label_of_an_unknown_class() -> None:
    refused(lambda: load(with_labels(CAR.replace("Car", "Carr"))), f"{TXT}, line 1", "Carr", "Pedestrian")


@hard_case(
    area=AREA,
    why="a box without a size has no volume to divide an overlap by, and one of 1e200 m none that is finite",
    must="an error that names the line",
    guard="sizes lie between a centimetre and ten kilometres",
)
def a_labelled_box_without_a_size() -> None:
    for word in ("0.00", "-1.65", "1e-320", "1e200"):
        refused(lambda word=word: load(with_labels(CAR.replace("1.65", word))), f"{TXT}, line 1", "box size")


@hard_case(
    area=AREA,
    why="DontCare rows say -1 and -1000 for what is not known",
    must="they are left out, and what stands around them stays in order",
    guard="DontCare is skipped before a number of it is read",
)
def labels_of_regions_that_do_not_count() -> None:
    scene = load(lambda folder: None)
    assert scene.labels.names == ("Car", "Van", "Pedestrian") and np.isfinite(scene.labels.boxes).all()


@hard_case(
    area=AREA,
    why="without Tr_velo_to_cam no label can be placed among the points",
    must="an error that names the file and the line that is missing",
    guard="all three matrices must be there",
)
def a_calibration_without_the_lidars_place() -> None:
    refused(lambda: load(with_matrix("Tr_velo_to_cam", None)), f"calib/{TXT}", "Tr_velo_to_cam")


@hard_case(
    area=AREA,
    why="eleven numbers are no 3 x 4 matrix",
    must="an error that names the line and both counts",
    guard="numbers are counted before they become a matrix",
)
def a_calibration_with_a_number_missing() -> None:
    for key in ("P2", "Tr_velo_to_cam"):
        short = CALIBRATION[key].ravel()[:-1]
        refused(lambda key=key, short=short: load(with_matrix(key, short)), f"calib/{TXT}, line", "11 numbers", key)


@hard_case(
    area=AREA,
    why="the determinant of diag(2, 0.5, 1) is that of a rotation, and every box would be stretched by it",
    must="an error that names the file; as for singular matrices and those whose product overflows",
    guard="the rows must be orthonormal",
)
def a_calibration_that_stretches() -> None:
    good = CALIBRATION["R0_rect"]
    for matrix in (np.diag([2.0, 0.5, 1.0]), good * 0.0, good * 1e200, np.ones((3, 3))):
        refused(lambda matrix=matrix: load(with_matrix("R0_rect", matrix)), f"calib/{TXT}", "no rotation")


@hard_case(
    area=AREA,
    why="a reflection is as orthonormal as a rotation: left and right would be exchanged",
    must="an error that names the file",
    guard="the determinant must be positive",
)
def a_calibration_that_mirrors() -> None:
    refused(lambda: load(with_matrix("R0_rect", np.diag([-1.0, 1.0, 1.0]))), f"calib/{TXT}", "no rotation")


@hard_case(
    area=AREA,
    why="a projection of zeros sends every point to one pixel, and average precision would count none of them",
    must="an error that names the file",
    guard="P2 must be the projection of a rectified camera",
)
def a_camera_without_a_focal_length() -> None:
    flat = CALIBRATION["P2"].copy()
    flat[0, 0] = 0.0
    refused(lambda: load(with_matrix("P2", flat)), f"calib/{TXT}", "P2")
