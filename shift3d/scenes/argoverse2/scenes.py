"""Argoverse 2 sweeps as scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse, moved
from shift3d.scenes.argoverse2.log import (
    Sweep,
    city_SE3_ego,
    ego_velocity_m_s,
    lidar_mounts,
    read_labels,
    read_sweep,
    sweep_file,
    timestamps,
)
from shift3d.scenes.argoverse2.map_files import map_files, read_ground_map
from shift3d.scenes.file_checks import abbreviated_list, names_in, require_metres
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sets import RecordedScenes
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike

VEHICLE_HEIGHT_M = 0.33  # of the vehicle frame's origin, the rear axle, above the ground
_SPLITS = ("val", "train", "test")


class Argoverse2Scenes(RecordedScenes):
    """Sweeps of the logs under a folder or bucket (``{log}/sensors/lidar/{timestamp}.feather``).

    Args:
        root: a split (train/, val/, test/), which holds logs, or one log.
        names: ``LOG-TIMESTAMP`` of the sweeps to use; None: every sweep, in order.
        count: maximum number of sweeps; the search stops there.
        every: use every n-th sweep of each log; has no effect on named sweeps.
        list_unreadable: also list named sweeps that do not exist; loading one raises InputError.

    A scene's origin is the upper LiDAR, its axes are the vehicle's, its time 0 the sweep's start. Points keep the order
    of the file. Every beam starts at its LiDAR's position at the firing time (two LiDARs of 32 beams, one above the
    other). Points are motion compensated to the sweep's start. The files store coordinates as float16: a point is up to
    half a step off along each axis, 1 mm within 2 m, 8 mm within 32 m, 3 cm beyond 64 m of the rear axle along that
    axis. Beams through these points are off by as much, across and along; directions by 0.5 mrad, on average less.

    Placements have the drivable areas and heights (float16: 3 to 6 cm) of a log's map/, if any; see `GroundMap`.

    Raises InputError: no logs.
    """

    dataset = "argoverse2"

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        every: int = 1,
        list_unreadable: bool = False,
    ) -> None:
        super().__init__(root, names, count, list_unreadable)
        self.every = every
        inside = names_in(self.root)
        own = {self.root.absolute().name: self.root}  # the name of "." is empty
        self._logs = own if "sensors" in inside else {name: self.root / name for name in inside}
        if not self._logs:
            raise InputError("no logs", str(self.root), "Give a folder of logs, or a log, which holds sensors/lidar/")

    def _read(self, name: str) -> Scene:
        log, timestamp = self._split(name)
        sweep, (up, down) = read_sweep(log, timestamp), lidar_mounts(log)
        points = (sweep.points - up).astype(np.float32)
        origins = (_origins(log, timestamp, sweep, up, down) - up).astype(np.float32)
        require_metres(np.linalg.norm(points - origins, axis=1), str(sweep_file(log, timestamp)))
        city_SE3_scene = city_SE3_ego(log, timestamp)[0]
        city_SE3_scene[:3, 3] += city_SE3_scene[:3, :3] @ up
        return Scene(
            scene_id=name,
            dataset=self.dataset,
            points=points,
            origins=origins,
            ground_z_m=estimate_ground_z(points, -float(up[2]) - VEHICLE_HEIGHT_M),
            labels=read_labels(log, timestamp, points, up),
            reflectance=sweep.reflectance,
            time_s=(sweep.offset_ns * 1e-9).astype(np.float32),
            conditions=Conditions(ego_velocity_m_s=ego_velocity_m_s(log, timestamp)),
            ground_map=read_ground_map(log, city_SE3_scene),
        )

    def _settings_and_files(self, name: str) -> tuple[tuple[()], Sequence[Location]]:
        try:
            log, timestamp = self._split(name)
        except InputError:
            return (), ()  # no log has the sweep; loading raises the error
        shared = (log / "annotations.feather", log / "city_SE3_egovehicle.feather")
        mounts = log / "calibration" / "egovehicle_SE3_sensor.feather"
        return (), (sweep_file(log, timestamp), *shared, mounts, *map_files(log))

    def _found(self) -> Iterator[str]:
        requested = None if self._wanted is None else {name.rpartition("-")[0] for name in self._wanted}
        every, bare = self.every if requested is None else 1, True
        for log, place in self._logs.items():
            if requested is None or log in requested:
                for timestamp in timestamps(place)[::every]:
                    bare = False
                    yield f"{log}-{timestamp}"
        splits = [name for name in _SPLITS if name in self._logs]
        if bare and splits:
            what, remedy = "a data set, not one of its splits", f"Give {self.root / splits[0]}"
            raise InputError(what, str(self.root), remedy)

    def _split(self, name: str) -> tuple[Location, int]:
        log, _, timestamp = name.rpartition("-")
        if log not in self._logs or not timestamp.isdecimal():
            remedy = f"Choose a log from: {abbreviated_list(self._logs)}"
            raise InputError(f"unknown scene {name!r}", str(self.root), remedy)
        return self._logs[log], int(timestamp)


def _origins(log: Location, timestamp: int, sweep: Sweep, up: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Compute positions (N, 3) float64 of each point's LiDAR as it fired, vehicle frame at the sweep's start."""
    times, which = np.unique(sweep.offset_ns, return_inverse=True)
    poses = inverse(city_SE3_ego(log, timestamp)[0]) @ city_SE3_ego(log, timestamp, times)
    mounts = np.where(sweep.is_up[:, None], up, down)
    return moved(mounts, poses[which])
