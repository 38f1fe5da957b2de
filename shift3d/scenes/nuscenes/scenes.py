"""nuScenes key frames as scenes, from one sweep or several sweeps joined."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse, moved, rigid
from shift3d.scenes.file_checks import abbreviated_list, names_in, read_records, require_metres, stems_in
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.nuscenes.tables import LidarFile, Poses, Release, boxes_of, read_annotations, read_weather
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sets import RecordedScenes
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike

Float = NDArray[np.float64]

LIDAR_HEIGHT_M = 1.84
OWN_VEHICLE_M = 1.0
"""Points of earlier sweeps within this distance of their sensor, in x and in y, belong to the recording vehicle."""
_SUFFIX = ".pcd.bin"
_SIDEWAYS = np.array([[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""vehicle_SE3_lidar without a table: the sensor's x points to the right and its y ahead."""


class NuScenesScenes(RecordedScenes):
    """Key frames of a release under a folder or bucket, or LiDAR files alone.

    Args:
        root: holds v1.0-*/, samples/ and sweeps/; or *.pcd.bin files, which have no labels, poses or other sweeps.
        names: samples (tokens) to use, or stems of files without tables; None: all, in order of time.
        count: maximum number of scenes.
        version: the folder of tables, such as v1.0-mini; None: the only folder.
        sweeps: number of sweeps in a scene: the key frame and those before it, fewer at the start of a drive.
        list_unreadable: also list names that no table has; loading one raises InputError.

    A scene's origin is the LiDAR at the key frame, its axes are the vehicle's. Its points are the key frame's, in the
    order of the file, then those of each earlier sweep, moved to the key frame by the vehicle's poses. Beams start at
    the sensor's position in their sweep. All points of a sweep have the same firing time: 0 for the key frame, minus
    the sweep's age for earlier sweeps. An inserted vehicle therefore stands still across sweeps as the world does, and
    with `effects.object_speed_m_s` each sweep meets it at its position at that time. The data set has motion
    compensated the points of a sweep. Poses have roll and pitch, but no height.

    Raises InputError: neither tables nor files, several versions to choose from, or several sweeps without tables.
    """

    dataset = "nuscenes"

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        version: str | None = None,
        sweeps: int = 1,
        list_unreadable: bool = False,
    ) -> None:
        super().__init__(root, names, count, list_unreadable)
        self.sweeps = sweeps
        self._tables = _tables(self.root, version)
        self._found_in = self._tables / "sample_data.json" if self._tables else self.root
        self._stems = [] if self._tables else stems_in(self.root, _SUFFIX)
        if self._tables is None and not self._stems:
            what = f"neither tables v1.0-*/ nor *{_SUFFIX} files"
            raise InputError(what, str(self.root), "Give the folder that holds them")
        if self._tables is None and sweeps > 1:
            what = f"no tables v1.0-*/, which say what came before a file: sweeps={sweeps} cannot be joined"
            remedy = "Give the folder that holds v1.0-*/ and sweeps/, or scenes.sweeps=1"
            raise InputError(what, str(self.root), remedy)

    def _read(self, name: str) -> Scene:
        if self._tables is None:
            return self._alone(name)
        release = self._release
        if name not in self._needed:
            known = abbreviated_list(self._needed or release.key_frames)
            raise InputError(f"unknown scene {name!r}", str(self._tables), f"Choose from: {known}")
        files = self._files(name)
        poses, mounts = self._poses
        key = files[0]
        global_SE3_scene = poses[key.pose] @ rigid(np.eye(3), mounts[key.mount][:3, 3])
        parts = []
        for file in files:
            scene_SE3_lidar = inverse(global_SE3_scene) @ poses[file.pose] @ mounts[file.mount]
            if file is key:
                scene_SE3_lidar[:3, 3] = 0.0  # a rounding error would count as a second beam origin
            parts.append(_sweep(self.root, file, scene_SE3_lidar, key.time_us))
        points, origins, reflectance, time_s = (np.concatenate(part) for part in zip(*parts, strict=True))
        annotations = self._annotations[name]
        where = f"{self._tables / 'sample_annotation.json'}, sample {name}"
        return replace(
            _scene(name, points, origins, reflectance),
            time_s=time_s if len(files) > 1 else None,
            labels=boxes_of(annotations, inverse(global_SE3_scene), points, where),
            conditions=Conditions(
                weather=self._weather[name], ego_velocity_m_s=_velocity(release, poses, key, global_SE3_scene)
            ),
        )

    def _settings_and_files(self, name: str) -> tuple[Sequence[int], list[Location]]:
        if self._tables is None:
            return (self.sweeps,), [_stem_file(self.root, name)]
        parts = self._files(name) if name in self._release.key_frames else []
        return (self.sweeps,), [*(self.root / part.filename for part in parts), *self._table_files]

    @functools.cached_property
    def _table_files(self) -> list[Location]:
        return [] if self._tables is None else [self._tables / name for name in self._tables.names()]

    def _found(self) -> Iterable[str]:
        return self._stems if self._tables is None else self._release.key_frames

    @functools.cached_property
    def _release(self) -> Release:
        assert self._tables is not None
        return Release.read(self._tables)

    @functools.cached_property
    def _needed(self) -> set[str]:
        return {name for name in self._listed if name in self._release.key_frames}

    @functools.cached_property
    def _poses(self) -> tuple[Poses, Poses]:
        """Poses of the vehicle and of the sensor, by token, for the listed scenes."""
        release, files = self._release, []
        for name in self._needed:
            last = self._files(name)[-1]
            files += [*self._files(name), *([release.lidar[last.previous]] if last.previous in release.lidar else [])]
        vehicle = release.poses("ego_pose", {file.pose for file in files})
        return vehicle, release.poses("calibrated_sensor", {file.mount for file in files})

    @functools.cached_property
    def _annotations(self) -> dict[str, list[dict[str, object]]]:
        return read_annotations(self._release.folder, self._needed)

    @functools.cached_property
    def _weather(self) -> dict[str, str]:
        return read_weather(self._release.folder, self._needed)

    def _files(self, name: str) -> list[LidarFile]:
        """Return the files of the key frame, then of the sweeps before it."""
        release = self._release
        files = [release.lidar[release.key_frames[name]]]
        while len(files) < self.sweeps and files[-1].previous in release.lidar:
            files.append(release.lidar[files[-1].previous])
        return files

    def _alone(self, name: str) -> Scene:
        self._require_listed(name)
        values = _lidar_rows(_stem_file(self.root, name))
        points = moved(values[:, :3], _SIDEWAYS).astype(np.float32)
        return _scene(name, points, np.zeros_like(points), _reflectance(values))


def _tables(root: Location, version: str | None) -> Location | None:
    found = [name for name in names_in(root) if name.startswith("v1.0-") and not (root / name).is_file()]
    if version is not None:
        if version not in found:
            remedy = f"Choose from: {abbreviated_list(found) or 'none there'}"
            raise InputError(f"no tables {version}/", str(root), remedy)
        return root / version
    if len(found) > 1:
        raise InputError(f"{len(found)} versions of tables", str(root), f"Give one: scenes.version={found[0]}")
    return root / found[0] if found else None


def _stem_file(root: Location, stem: str) -> Location:
    return root / f"{stem}{_SUFFIX}"


def _sweep(
    root: Location, file: LidarFile, scene_SE3_lidar: Float, key_time_us: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Read points, origins, reflectance and firing times of one sweep, in the frame of the key frame's scene."""
    values = _lidar_rows(root / file.filename.lstrip("/"))
    if file.time_us != key_time_us:
        values = values[(np.abs(values[:, :2]) >= OWN_VEHICLE_M).any(axis=1)]
    points = moved(values[:, :3], scene_SE3_lidar).astype(np.float32)
    origins = np.broadcast_to(scene_SE3_lidar[:3, 3].astype(np.float32), points.shape)
    time_s = np.full(len(points), (file.time_us - key_time_us) * 1e-6, dtype=np.float32)
    return points, origins, _reflectance(values), time_s


def _lidar_rows(file: Location) -> NDArray[np.float32]:
    """Read x, y, z, intensity, ring (N, 5) of a LiDAR file. Raises InputError: missing, damaged, or in other units."""
    values = read_records(file, "LiDAR file", 5)
    require_metres(np.linalg.norm(values[:, :3].astype(np.float64), axis=1), str(file))
    if not ((values[:, 3] >= 0.0) & (values[:, 3] <= 255.0)).all():
        raise InputError("an intensity that is not 0 to 255", str(file), "Copy it again")
    return values


def _reflectance(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return values[:, 3] / np.float32(255.0)


def _scene(
    name: str, points: NDArray[np.float32], origins: NDArray[np.float32], reflectance: NDArray[np.float32]
) -> Scene:
    ground_z_m = estimate_ground_z(points, -LIDAR_HEIGHT_M)
    return Scene(name, NuScenesScenes.dataset, points, origins, ground_z_m, reflectance=reflectance)


def _velocity(
    release: Release, poses: Poses, key: LidarFile, global_SE3_scene: Float
) -> tuple[float, float, float] | None:
    """Compute the sensor's velocity since the previous sweep, m/s, scene frame; None at the start of a drive."""
    before = release.lidar.get(key.previous)
    if before is None or before.time_us >= key.time_us:
        return None
    driven = poses[key.pose][:3, 3] - poses[before.pose][:3, 3]
    along = global_SE3_scene[:3, :3].T @ driven / ((key.time_us - before.time_us) * 1e-6)
    return (float(along[0]), float(along[1]), float(along[2]))
