"""Detections over scenes: frames, vehicles that count in KITTI, and the same bits from several processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from small_scenes import (
    GROUND_Z_M,
    SmallScenes,
    open_broken_scenes,
    open_point_detector,
    small_scene,
)

from shift3d.analysis import detector_evaluation
from shift3d.detectors.base import BevWindow, Detections, Proposals
from shift3d.errors import InputError
from shift3d.evaluation.frames import DetectedFrame
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.settings.schema.scenes import KittiConfig
from shift3d.store.arrays import write_arrays
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.training.detector.detect_scenes import detect_frame, detect_scenes
from shift3d.training.detector_scenes import from_scene, network_points


class _Known:
    """Detector that answers with given network-frame boxes, and records its calls."""

    name = "known"

    def __init__(self, boxes: np.ndarray, scores: list[float]) -> None:
        self.boxes, self.scores = boxes, np.array(scores, dtype=float)
        self.requested: list[tuple[torch.Tensor, BevWindow | None, float]] = []

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        raise NotImplementedError

    def proposals(self, points: torch.Tensor, window: BevWindow | None = None) -> Proposals:
        raise NotImplementedError

    def detect(
        self,
        points: torch.Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float = 0.25,
    ) -> Detections:
        self.requested.append((points, window, score_threshold))
        return Detections(self.boxes, self.scores)


def _network(boxes: np.ndarray) -> np.ndarray:
    return boxes + np.array([0, 0, -GROUND_Z_M, 0, 0, 0, 0])


def test_a_frame_holds_vehicles_and_detections_in_the_scene_frame() -> None:
    labels = small_scene("small-0").labels.boxes
    detector = _Known(_network(labels[:2]), [0.9, 0.02])
    frame = detect_frame(detector, SmallScenes(), "small-0", score_threshold=0.02).frame
    np.testing.assert_allclose(frame.found.boxes, labels[:2], atol=1e-12)
    assert frame.found.scores.tolist() == [0.9, 0.02] and frame.found.labelled.all()
    assert np.isnan(frame.found.image_height_px).all()
    assert frame.truth.boxes.tolist() == labels[[0, 1, 3]].tolist()  # not the pedestrian
    assert frame.truth.num_points.tolist() == [50, 5, 50] and frame.truth.counts.all()
    assert frame.truth.difficulty.tolist() == [-1] * 3
    (points, window, score_threshold) = detector.requested[0]
    assert window is None and score_threshold == 0.02  # the whole grid
    assert len(points) == 299 and points[:, 2].min() >= -1e-3  # only beams; the ground is at zero


def test_a_detector_that_finds_nothing() -> None:
    frame = detect_frame(_Known(np.zeros((0, 7)), []), SmallScenes(), "small-0").frame
    assert frame.found.boxes.shape == (0, 7) and len(frame.truth.boxes) == 3


def _bits(frame: DetectedFrame) -> tuple[object, ...]:
    arrays = (*vars(frame.truth).values(), *vars(frame.found).values())
    return (frame.scene, *(item.tobytes() if isinstance(item, np.ndarray) else item for item in arrays))


def test_several_processes_give_the_same_bits_in_the_same_order_and_the_same_error() -> None:
    """The last of the five scenes cannot be read: the scenes before it arrive, then the error, from either."""
    seen = []
    for workers in (1, 2):
        frames = []
        with pytest.raises(InputError, match=r"small-4\.bin: truncated"):
            for answer in detect_scenes(open_point_detector, open_broken_scenes, workers):
                frames.append(answer.frame)  # noqa: PERF401 - those that came before the error are looked at
        assert [frame.scene for frame in frames] == SmallScenes().names()[:4]
        seen.append([_bits(frame) for frame in frames])
    assert seen[0] == seen[1] and len({bits[1:] for bits in seen[0]}) == 4


KITTI_LABELS = """\
Pedestrian 0.00 0 0.0 500 150 520 200 1.80 0.60 0.80 0.00 1.70 15.00 0.0
DontCare -1 -1 -10 500 150 520 200 -1 -1 -1 -1000 -1000 -1000 -10
Car 0.00 0 0.0 500 150 600 200 1.50 1.60 4.00 0.00 1.70 20.00 -1.57
Car 0.00 1 0.0 500 150 600 180 1.50 1.60 4.00 5.00 1.70 40.00 -1.57
Van 0.00 0 0.0 500 150 600 200 2.00 1.80 5.00 -5.00 1.70 25.00 -1.57
Car 0.60 0 0.0 500 150 600 200 1.50 1.60 4.00 -5.00 1.70 15.00 -1.57
"""


def _kitti(folder: Path) -> KittiScenes:
    for part in ("velodyne", "calib", "label_2"):
        (folder / "training" / part).mkdir(parents=True)
    points = np.array([[20.0, 0.5, -1.0, 0.3], [19.0, -0.5, -0.8, 0.4], [20.0, 5.0, -1.7, 0.2]])
    points.astype("<f4").tofile(folder / "training" / "velodyne" / "000000.bin")
    rows = {
        "P2": "700 0 600 0 0 700 180 0 0 0 1 0",
        "R0_rect": "1 0 0 0 1 0 0 0 1",
        "Tr_velo_to_cam": "0 -1 0 0 0 0 -1 0 1 0 0 0",
    }
    text = "".join(f"{key}: {values}\n" for key, values in rows.items())
    (folder / "training" / "calib" / "000000.txt").write_text(text)
    (folder / "training" / "label_2" / "000000.txt").write_text(KITTI_LABELS)
    return KittiScenes(folder)


def test_in_kitti_frames_cars_count_and_labels_are_graded(tmp_path: Path) -> None:
    scenes = _kitti(tmp_path)
    ahead = [20.0, 0.0, -0.95, 4.0, 1.6, 1.5, 0.0]
    behind = [-20.0, 0.0, -0.95, 4.0, 1.6, 1.5, 0.0]
    scene = scenes.load("000000")
    boxes = np.array([ahead, behind]) - np.array([0, 0, scene.ground_z_m, 0, 0, 0, 0])
    frame = detect_frame(_Known(boxes, [0.9, 0.8]), scenes, "000000").frame
    assert frame.truth.names == ("Car", "Car", "Van", "Car")
    assert frame.truth.counts.tolist() == [True, True, False, True]
    # 50 pixels and in the open; 30 pixels and partly hidden; as the first; more than half outside the image.
    assert frame.truth.difficulty.tolist() == [0, 1, 0, 3]
    assert frame.found.labelled.tolist() == [True, False]
    # Its lower image edge is that of the rear, 18 m away and 1.7 m below the camera; its upper edge that of the front,
    # 22 m away and 0.2 m below.
    assert frame.found.image_height_px[0] == pytest.approx(700 * (1.7 / 18 - 0.2 / 22), abs=1e-6)


def test_training_scenes_are_in_the_network_frame() -> None:
    scene = small_scene("small-0")
    made = from_scene(scene)
    assert made.sensor_height_m == pytest.approx(1.73)
    assert len(made.points) == 299 and made.boxes.shape == (3, 7)
    assert np.allclose(made.boxes, _network(scene.labels.boxes[[0, 1, 3]]), atol=1e-5)
    assert np.array_equal(network_points(scene)[1:], made.points)


@pytest.mark.parametrize("part", ["scenes/kitti/scenes.py", "detectors/nms.py", "training/detector_scenes.py"])
def test_what_another_program_detected_is_detected_again(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_evaluation, "detector_of", lambda *_: open_point_detector())
    _kitti(tmp_path / "frames")
    frames = KittiConfig(kind="kitti", root=str(tmp_path / "frames"), count=None, names=None)

    def found() -> int:
        detector_evaluation.evaluate_detector("pointpillars", frames, tmp_path / "out")
        return int(pq.read_table(tmp_path / "out" / "detections.parquet").num_rows)

    before = found()
    for file in (tmp_path / "out" / "scenes").iterdir():  # like the files of a program without detections
        with np.load(file) as data:
            kept = dict(data)
        nothing = {name: kept[name][:0] for name in ("boxes", "scores", "labelled", "image_height_px")}
        write_arrays(file, **{**kept, **nothing})
    assert before > 0 and found() == 0
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(f"/{part}"))
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr(detector_evaluation, "program_digest", program_digest.__wrapped__, raising=False)
    assert found() == before


def test_a_frame_whose_labels_changed_is_evaluated_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detector_evaluation, "detector_of", lambda *_: open_point_detector())
    _kitti(tmp_path / "frames")
    out = tmp_path / "out"

    def rows() -> int:
        frames = KittiConfig(kind="kitti", root=str(tmp_path / "frames"), count=None, names=None)
        detector_evaluation.evaluate_detector("pointpillars", frames, out)
        return int(pq.read_table(out / "truth.parquet").num_rows)

    assert rows() == 4 and rows() == 4
    labels = tmp_path / "frames" / "training" / "label_2" / "000000.txt"
    labels.write_text("".join(KITTI_LABELS.splitlines(keepends=True)[:3]))
    assert rows() == 1
