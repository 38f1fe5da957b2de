"""Detections over a scene set for all metrics, in one process or several, with the same results bit for bit.

Results are stored in one small file per scene, so that an interrupted evaluation resumes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

from shift3d.detectors.base import Detector
from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth
from shift3d.processes import each, threads
from shift3d.scenes.kitti.files import Calibration
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import SceneSet
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.training.detector_scenes import network_points

# Waymo's second score cut-off. Detectors keep the best 4096 boxes before non-maximum suppression, whatever their score:
# if 4096 boxes score above 0.1, a lower floor has neither a cost nor an effect.
SCORE_FLOOR = 0.01


@dataclass(frozen=True)
class SceneDetections:
    """Detections and ground truth of a frame; milliseconds to load the scene and to detect."""

    frame: DetectedFrame
    scene_ms: float
    detect_ms: float


def detect_frame(
    detector: Detector, scenes: SceneSet, name: str, score_threshold: float = SCORE_FLOOR
) -> SceneDetections:
    """Load one scene, run the detector on its whole grid, and record ground truth and detections in the scene frame.

    In KITTI frames only cars count, boxes outside the camera's view are marked as unlabelled, and labels carry KITTI's
    difficulty. Vans are ignored as in KITTI's development kit. Trucks are also ignored (our choice: the detectors have
    one class for all three; the kit counts a detected truck as an error).

    Raises InputError: the scene cannot be read.
    """
    start = perf_counter()
    scene = scenes.load(name)
    loaded = perf_counter()
    points = torch.from_numpy(network_points(scene)[scene.has_beam])
    detections = detector.detect(points, score_threshold=score_threshold)
    done = perf_counter()
    boxes = np.array(detections.boxes, dtype=np.float64).reshape(-1, 7)
    boxes[:, 2] += scene.ground_z_m
    view = scenes.camera_view(name) if isinstance(scenes, KittiScenes) else None
    frame = DetectedFrame(name, _truth(scenes, scene), _found(boxes, np.asarray(detections.scores), view))
    return SceneDetections(frame, 1e3 * (loaded - start), 1e3 * (done - loaded))


def _found(boxes: np.ndarray, scores: np.ndarray, view: Calibration | None) -> FrameDetections:
    if view is None:
        return FrameDetections(boxes, scores, np.ones(len(boxes), dtype=bool), np.full(len(boxes), np.nan))
    return FrameDetections(boxes, scores, view.in_view(boxes), view.height_px(boxes))


def _truth(scenes: SceneSet, scene: Scene) -> GroundTruth:
    labels = scene.labels
    mask = labels.mask("vehicle")
    rows = np.flatnonzero(mask)
    names = tuple(labels.names[row] for row in rows) if labels.names else ("",) * len(rows)
    counts, difficulty = np.ones(len(rows), dtype=bool), np.full(len(rows), -1, dtype=np.int64)
    if isinstance(scenes, KittiScenes) and len(rows):
        counts = np.array([name == "Car" for name in names], dtype=bool)
        label_rows = scenes.label_rows(scene.scene_id)
        difficulty = np.array([label_rows[row].difficulty for row in rows], dtype=np.int64)
    boxes = labels.of_class("vehicle").reshape(-1, 7)
    kinds = tuple(labels.kinds[row] for row in rows) if labels.kinds else ()
    return GroundTruth(boxes, labels.num_points[mask].astype(np.int64), counts, difficulty, names, kinds)


def detect_scenes(
    open_detector: Callable[[], Detector],
    open_scenes: Callable[[], SceneSet],
    workers: int = 1,
    score_threshold: float = SCORE_FLOOR,
    names: list[str] | None = None,
) -> Iterator[SceneDetections]:
    """Yield the result of every scene of a set, or of every scene in ``names``, in that order.

    open_detector, open_scenes: called once in every process; with several workers both must be picklable. Every process
    computes on one thread: more threads would sum in another order and change the bits.

    Raises InputError: a scene cannot be read, or the detector cannot be opened.
    """
    names = open_scenes().names() if names is None else names
    if not names:
        return
    if min(workers, len(names)) > 1:
        open_detector()  # its errors must be raised here: a worker that cannot start reports none
    with threads(1):
        hold = partial(_opened, open_detector, open_scenes)
        yield from each(partial(_detect, score_threshold), names, workers, hold)


def _opened(open_detector: Callable[[], Detector], open_scenes: Callable[[], SceneSet]) -> tuple[Detector, SceneSet]:
    return open_detector(), open_scenes()


def _detect(score_threshold: float, opened: tuple[Detector, SceneSet], name: str) -> SceneDetections:
    return detect_frame(*opened, name, score_threshold)


def stored_or_detected(
    names: Iterable[str],
    folder: Path,
    detect: Callable[[list[str]], Iterator[SceneDetections]],
    state_of: Callable[[str], str] = lambda name: "",
) -> Iterator[SceneDetections]:
    """Yield the result of every scene in order: read from ``folder`` if stored there, else detected and stored.

    detect: maps names of missing scenes to their results, in that order. state_of: maps a scene's name to the state of
    its inputs; a stored result of another state is detected again. Empty: the name identifies the result.

    Raises InputError: a file in ``folder`` is torn, or whatever ``detect`` raises.
    """
    names = list(names)
    states = {name: state_of(name) for name in names}  # before inputs are read: the next run detects later changes
    missing = [name for name in names if not _is_kept(_file(folder, name), states[name])]
    coming, left = detect(missing), set(missing)
    for name in names:
        if name in left:
            answer = next(coming)
            write_scene_detections(_file(folder, name), answer, states[name])
            yield answer
        else:
            yield read_scene_detections(_file(folder, name))


def _is_kept(file: Path, state: str) -> bool:
    """True if the file holds a result of this state."""
    if not file.exists() or not state:
        return file.exists()
    with read_arrays(file) as data:
        return "state" in data and str(data["state"]) == state


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name.replace('/', '_')}.npz"


def write_scene_detections(file: Path, answer: SceneDetections, state: str = "") -> None:
    """Write one result atomically. state: see `stored_or_detected`. Raises InputError on a full disk."""
    truth, found = answer.frame.truth, answer.frame.found
    write_arrays(
        file,
        scene=np.array(answer.frame.scene),
        milliseconds=np.array([answer.scene_ms, answer.detect_ms]),
        truth_boxes=truth.boxes,
        num_points=truth.num_points,
        counts=truth.counts,
        difficulty=truth.difficulty,
        names=np.array(truth.names, dtype=np.str_),
        kinds=np.array(truth.kinds, dtype=np.str_),
        **vars(found),
        **({"state": np.array(state)} if state else {}),
    )


def read_scene_detections(file: Path) -> SceneDetections:
    """Read a file of :func:`write_scene_detections`, bit for bit. Raises InputError for any other file."""
    with read_arrays(file) as data:
        truth = GroundTruth(
            data["truth_boxes"],
            data["num_points"],
            data["counts"],
            data["difficulty"],
            tuple(str(name) for name in data["names"]),
            tuple(str(kind) for kind in data["kinds"]),
        )
        found = FrameDetections(data["boxes"], data["scores"], data["labelled"], data["image_height_px"])
        scene_ms, detect_ms = (float(value) for value in data["milliseconds"])
        return SceneDetections(DetectedFrame(str(data["scene"]), truth, found), scene_ms, detect_ms)
