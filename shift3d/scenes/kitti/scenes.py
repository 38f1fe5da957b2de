"""KITTI object frames as scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import corners_3d, points_in_boxes
from shift3d.scenes.facts import SceneFacts
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.kitti.files import (
    CLASSES,
    GROUND,
    Calibration,
    KittiLabel,
    read_calibration,
    read_ground_z,
    read_labels,
    read_points,
)
from shift3d.scenes.listing import first_few, names_in
from shift3d.scenes.scene import Labels, Scene
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location

NOMINAL_GROUND_Z_M = -1.73  # over the labelled sample frames the estimate lies between -1.80 and -1.63
IMAGE_SIZE = (1242, 375)  # pixels; frames differ by a few, and the images are not needed otherwise


@dataclass(frozen=True)
class CameraView:
    """What camera 2 sees: only there does KITTI have labels."""

    calibration: Calibration

    def in_image(self, points: NDArray[np.floating], margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Which points (N, 3) of the LiDAR frame fall into the image, margin_px inside its edge: (N,) bool."""
        pixels, depth = self.calibration.pixels(points)
        inside = (pixels >= margin_px) & (pixels < np.array(IMAGE_SIZE) - margin_px)
        result: NDArray[np.bool_] = inside.all(axis=1) & (depth > 0.0)
        return result

    def in_view(self, boxes: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Which boxes (M, 7) have their centre between the image's left and right edge: (M,) bool.

        For average precision: a detection outside may be right and yet has no label to match.
        """
        pixels, depth = self.calibration.pixels(np.asarray(boxes)[:, :3])
        result: NDArray[np.bool_] = (pixels[:, 0] >= 0) & (pixels[:, 0] < IMAGE_SIZE[0]) & (depth > 0.0)
        return result

    def height_px(self, boxes: NDArray[np.floating]) -> NDArray[np.float64]:
        """Height in the image of boxes (M, 7), cut at its upper and lower edge: (M,) float64, pixels.

        A box that reaches behind the camera takes the whole height.
        """
        pixels, depth = self.calibration.pixels(corners_3d(boxes).reshape(-1, 3))
        rows = np.clip(pixels[:, 1], 0.0, IMAGE_SIZE[1]).reshape(-1, 8)
        height: NDArray[np.float64] = rows.max(axis=1, initial=0.0) - rows.min(axis=1, initial=IMAGE_SIZE[1])
        return np.where((depth.reshape(-1, 8) > 0.1).all(axis=1), height, float(IMAGE_SIZE[1]))


class KittiScenes:
    """Labelled KITTI frames under a folder or bucket.

    Args:
        root: the folder that holds ``training/``, or ``training`` itself.
        names: frame numbers to use ("000134"); None takes every frame that has a point file, sorted.
        reflectance_max: what the files call full reflectance; None: 1, as KITTI's own.
        keep_bad: list frames whose files are missing, too; loading one raises InputError.

    Scenes keep the point order of the files. Points at zero range stay in place and carry no beam
    (:attr:`~shift3d.scenes.scene.Scene.has_beam`). Labels cover camera 2's view only, 0.70 rad to either side of
    +x: objects are placed within 0.6 rad, so that most of the vehicle stays inside.

    Raises InputError: where folders are missing; without keep_bad, where frames are, or a label file has no frame.
    """

    dataset = "kitti"
    placement_sector_rad = (0.0, 0.6)

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        reflectance_max: float | None = None,
        keep_bad: bool = False,
    ) -> None:
        root = as_location(root)
        self.reflectance_max = reflectance_max
        self.folder = root if "velodyne" in names_in(root) else root / "training"
        parts = names_in(self.folder)
        for part in ("velodyne", "calib"):
            if part not in parts:
                raise InputError(
                    f"no folder training/{part}", str(root), "Give the folder that holds KITTI's training/ folder."
                )
        self._has_labels = "label_2" in parts
        found = _stems(self.folder / "velodyne", ".bin")
        if keep_bad:
            found |= self._labelled() if names is None else set(names)
        if names is None:
            self._refuse_orphans(found)
        for name in names or ():
            if name not in found:
                raise InputError(
                    f"no frame {name!r}", str(self.folder / "velodyne"), f"Choose from: {first_few(found)}."
                )
        self._names = sorted(found) if names is None else list(names)
        if not self._names:
            raise InputError("no frames (*.bin)", str(self.folder / "velodyne"), "Give a folder with KITTI frames.")

    def names(self) -> list[str]:
        """Frame numbers."""
        return list(self._names)

    def load(self, name: str) -> Scene:
        """One frame. Raises InputError: naming the file, the line or row, and the remedy."""
        if name not in self._names:
            raise InputError(f"unknown scene {name!r}", "KITTI scenes", f"Choose from: {first_few(self._names)}.")
        points, reflectance = read_points(self.folder / "velodyne" / f"{name}.bin", self.reflectance_max)
        ground = self.folder / GROUND / f"{name}.txt"
        scene = Scene(
            scene_id=name,
            dataset=self.dataset,
            points=points,
            origins=np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape),
            ground_z_m=read_ground_z(ground) if ground.is_file() else estimate_ground_z(points, NOMINAL_GROUND_Z_M),
            labels=self._labels(name, points),
            reflectance=reflectance,
        )
        scene.validate()
        return scene

    def configured(self, name: str) -> tuple[str, SceneFacts] | None:
        """See `SceneSet`: nothing is known of a frame but by its files."""
        return None

    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """See `SceneSet`: path and version of each of the frame's files."""
        values: list[str | int | float | None] = ["kitti", name, self.reflectance_max, self._has_labels]
        for part, suffix in (("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt"), (GROUND, "txt")):
            file = self.folder / part / f"{name}.{suffix}"
            values += [str(file.absolute()), file.version()]
        return tuple(values)

    def camera_view(self, name: str) -> CameraView:
        """What camera 2 sees of one frame."""
        return CameraView(read_calibration(self.folder / "calib" / f"{name}.txt"))

    def label_rows(self, name: str) -> list[KittiLabel]:
        """The labels of one frame, in the order of the scene's, with what they say about the image.

        Raises InputError: the label file is missing or malformed.
        """
        calibration = self.camera_view(name).calibration
        return read_labels(self.folder / "label_2" / f"{name}.txt", calibration)

    def _labels(self, name: str, points: NDArray[np.float32]) -> Labels:
        if not self._has_labels:
            return Labels()
        rows = self.label_rows(name)
        boxes = np.stack([row.box for row in rows]) if rows else np.zeros((0, 7))
        return Labels(
            boxes=boxes,
            classes=tuple(CLASSES[row.name] for row in rows),
            num_points=points_in_boxes(points, boxes).sum(axis=1).astype(np.int32),
            names=tuple(row.name for row in rows),
        )

    def _labelled(self) -> set[str]:
        return _stems(self.folder / "label_2", ".txt") if self._has_labels else set()

    def _refuse_orphans(self, found: set[str]) -> None:
        orphans = sorted(self._labelled() - found)
        if orphans:
            raise InputError(
                f"no frame velodyne/{orphans[0]}.bin",
                str(self.folder / "label_2" / f"{orphans[0]}.txt"),
                "Add the frame, remove the label file, or list the frames to use in scenes.names.",
            )


def _stems(folder: Location, suffix: str) -> set[str]:
    return {name.removesuffix(suffix) for name in folder.names() if name.endswith(suffix)}
