"""KITTI object frames as scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.file_checks import names_in, stems_in
from shift3d.scenes.ground_map import estimate_ground_z, search_ground_z
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
from shift3d.scenes.scene import Labels, Scene
from shift3d.scenes.sets import RecordedScenes, shared_origins
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike

NOMINAL_GROUND_Z_M = -1.73  # the estimates of the labelled sample frames lie between -1.80 and -1.63
_NOMINAL_WITHIN_M = 0.2  # within it the estimate around the nominal height sees the whole ground layer


class KittiScenes(RecordedScenes):
    """Labelled KITTI frames under a folder or bucket.

    Args:
        root: the folder that holds ``training/``, or ``training`` itself.
        names: frame numbers to use ("000134"); None: every frame that has a point file, sorted.
        count: maximum number of frames.
        reflectance_max: file value of full reflectance; None: 1, as in KITTI's own files.
        list_unreadable: also list frames whose files are missing; loading one raises InputError.

    Scenes keep the point order of the files. Points at zero range stay in place and carry no beam
    (:attr:`~shift3d.scenes.scene.Scene.has_beam`). The ground is searched around KITTI's 1.73 m below the LiDAR, or at
    any height if it lies more than 0.2 m from there, since other vehicles mount their LiDAR elsewhere. Labels cover
    camera 2's view only, 0.70 rad to either side of +x: placements lie within 0.6 rad, most of the vehicle in view.

    Raises InputError: missing folders; without list_unreadable, missing frames, or a label file without a frame.
    """

    dataset = "kitti"
    placement_sector_rad = (0.0, 0.6)

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        reflectance_max: float | None = None,
        list_unreadable: bool = False,
    ) -> None:
        super().__init__(root, names, count, list_unreadable)
        self.reflectance_max = reflectance_max
        self.folder = self.root if "velodyne" in names_in(self.root) else self.root / "training"
        parts = names_in(self.folder)
        for part in ("velodyne", "calib"):
            if part not in parts:
                remedy = "Give the folder that holds KITTI's training/ folder."
                raise InputError(f"no folder training/{part}", str(self.root), remedy)
        self._labels_in = self.folder / "label_2" if "label_2" in parts else None
        self._found_in = self.folder / "velodyne"
        self.names()

    def _found(self) -> list[str]:
        frames = set(stems_in(self._found_in, ".bin"))
        labelled = set() if self._labels_in is None else set(stems_in(self._labels_in, ".txt"))
        orphans = sorted(labelled - frames)
        if orphans and self._wanted is None and not self.list_unreadable:
            what = f"no frame velodyne/{orphans[0]}.bin"
            remedy = "Add the frame, remove the label file, or list the frames to use in scenes.names."
            raise InputError(what, str(self.folder / "label_2" / f"{orphans[0]}.txt"), remedy)
        return sorted(frames | labelled if self.list_unreadable else frames)

    def _read(self, name: str) -> Scene:
        self._require_listed(name)
        points, reflectance = read_points(self.folder / "velodyne" / f"{name}.bin", self.reflectance_max)
        ground = self.folder / GROUND / f"{name}.txt"
        return Scene(
            scene_id=name,
            dataset=self.dataset,
            points=points,
            origins=shared_origins(points),
            ground_z_m=read_ground_z(ground) if ground.is_file() else _ground_z(points),
            labels=self._labels(name, points),
            reflectance=reflectance,
        )

    def _settings_and_files(self, name: str) -> tuple[Sequence[float | None], list[Location]]:
        parts = (("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt"), (GROUND, "txt"))
        files = [self.folder / part / f"{name}.{suffix}" for part, suffix in parts]
        return (self.reflectance_max, self._labels_in is not None), files

    def camera_view(self, name: str) -> Calibration:
        """Read the calibration of camera 2 of one frame."""
        return read_calibration(self.folder / "calib" / f"{name}.txt")

    def label_rows(self, name: str) -> list[KittiLabel]:
        """Read the labels of one frame with their image data, in the order of the scene's labels.

        Raises InputError: the label file is missing or malformed.
        """
        return read_labels(self.folder / "label_2" / f"{name}.txt", self.camera_view(name))

    def _labels(self, name: str, points: NDArray[np.float32]) -> Labels:
        if self._labels_in is None:
            return Labels()
        rows = self.label_rows(name)
        boxes, names = np.array([row.box for row in rows]).reshape(-1, 7), tuple(row.name for row in rows)
        return Labels.of_file(boxes, tuple(CLASSES[name] for name in names), names, points, str(self._labels_in))


def _ground_z(points: NDArray[np.float32]) -> float:
    """Estimate the height of the ground, metres, by the rule of `KittiScenes`. Source: our choice."""
    found = search_ground_z(points)
    if found is None or abs(found - NOMINAL_GROUND_Z_M) <= _NOMINAL_WITHIN_M:
        return estimate_ground_z(points, NOMINAL_GROUND_Z_M)
    return found
