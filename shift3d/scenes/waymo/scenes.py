"""Frames of the Waymo Open Dataset, version 2, as scenes."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse
from shift3d.scenes.file_checks import abbreviated_list, names_in, require_metres, stems_in
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.scene import Conditions, Labels, Scene
from shift3d.scenes.sensor import NoReturnBeams
from shift3d.scenes.sets import RecordedScenes
from shift3d.scenes.waymo.frame import (
    LASERS,
    LaserFrame,
    component_file,
    read_calibrations,
    read_frame,
    read_labels,
    read_vehicle_pose,
    read_weather,
)
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike

COMPONENTS = ("lidar", "lidar_calibration", "lidar_pose", "vehicle_pose")
"""Required components of a frame. The others are optional, but must be complete."""
_OPTIONAL = ("lidar_box", "stats")
_SEGMENTS_AT_ONCE = 16


class WaymoScenes(RecordedScenes):
    """Frames under a folder or bucket with ``{component}/{segment}.parquet``.

    Args:
        root: holds lidar/, lidar_calibration/, lidar_pose/, vehicle_pose/, and optionally lidar_box/ (labels) and
            stats/ (weather).
        names: ``SEGMENT-TIMESTAMP`` of the frames to use; None: every frame, in order.
        count: maximum number of frames; the search stops there.
        lasers: names of the sensors to use, from `LASERS`.
        every: use every n-th frame of each segment; has no effect on named frames.
        list_unreadable: list a segment without a readable list of frames by its own name; loading raises InputError.

    A scene's origin is the TOP laser (its axes are the vehicle's), whether or not that laser is used. Points are
    ordered by laser, then by return, then row by row of the range image. Pixels without a range in both returns are
    `Scene.no_return`. Every beam starts at its sensor's position by the pixel's own pose. Points are motion compensated
    to the frame's time. The data set states no firing times. Reflectance is tanh of the intensity, which has no upper
    limit: detectors of this data set are trained on that scale.

    Raises InputError: no component lidar/, an unknown laser, or a laser twice.
    """

    dataset = "waymo"

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        lasers: Sequence[str] = tuple(LASERS),
        every: int = 1,
        list_unreadable: bool = False,
    ) -> None:
        super().__init__(root, names, count, list_unreadable)
        self.lasers, self.every = tuple(lasers), every
        unknown = [name for name in lasers if name not in LASERS]
        if unknown or not lasers:
            what = f"unknown laser {(unknown or ['none at all'])[0]!r}"
            raise InputError(what, "Waymo", f"Choose from {', '.join(LASERS)}")
        if len(set(self.lasers)) < len(self.lasers):
            what = f"a laser twice in scenes.lasers=[{','.join(self.lasers)}]"
            raise InputError(what, "Waymo", "Name each laser once")
        if "lidar" not in self._components:
            remedy = "Give the folder that holds lidar/, lidar_pose/, ..."
            raise InputError("no component lidar/", str(self.root), remedy)
        self._found_in = self.root / "lidar"

    def _read(self, name: str) -> Scene:
        segment, timestamp = self._split(name)
        frames = read_frame(self.root, segment, timestamp, self.lasers)
        top = LASERS["TOP"]
        offset = read_calibrations(self.root, segment, [top])[top].vehicle_SE3_laser[:3, 3]  # the scene's origin
        where = f"{component_file(self.root, 'lidar', segment).file}, frame {timestamp}"
        has_labels, has_weather = "lidar_box" in self._components, "stats" in self._components
        parts = [_returns(frame, number, offset) for frame in frames for number in (0, 1)]
        points, origins, intensity, zone, pixel, number = (np.concatenate(part) for part in zip(*parts, strict=True))
        require_metres(np.linalg.norm(points - origins, axis=1), where)
        if not np.isfinite(intensity).all():
            raise InputError("an intensity that is not finite", where, "Copy the component again")
        return Scene(
            scene_id=name,
            dataset=self.dataset,
            points=points,
            origins=origins,
            ground_z_m=estimate_ground_z(points, -float(offset[2])),
            labels=read_labels(self.root, segment, timestamp, points, offset) if has_labels else Labels(),
            reflectance=np.tanh(np.maximum(intensity, 0.0)),
            return_number=number,
            range_image_index=pixel,
            conditions=Conditions(
                weather=read_weather(self.root, segment, timestamp) if has_weather else "dry",
                ego_velocity_m_s=self._velocity(segment, timestamp),
            ),
            no_return=_no_return(frames, offset),
            in_no_label_zone=zone,
        )

    def _settings_and_files(self, name: str) -> tuple[Sequence[str], list[Location]]:
        segment, parts = name.rpartition("-")[0] or name, (*COMPONENTS, *_OPTIONAL)
        return self.lasers, [component_file(self.root, part, segment).file for part in parts]

    def _found(self) -> Iterator[str]:
        """List the frames, reading `_SEGMENTS_AT_ONCE` segments at a time."""
        segments = self._segments
        if self._wanted is not None:
            requested = {name.rpartition("-")[0] or name for name in self._wanted}
            segments = [segment for segment in segments if segment in requested]
        for start in range(0, len(segments), _SEGMENTS_AT_ONCE):
            for names in self.root.each(self._frames_of, segments[start : start + _SEGMENTS_AT_ONCE]):
                yield from names

    def _frames_of(self, segment: str) -> list[str]:
        try:
            timestamps = component_file(self.root, "lidar", segment).timestamps()
        except InputError:
            if not self.list_unreadable:
                raise
            return [segment]
        return [f"{segment}-{timestamp}" for timestamp in timestamps[:: self.every if self._wanted is None else 1]]

    def _split(self, name: str) -> tuple[str, int]:
        segment, _, timestamp = name.rpartition("-")
        if not timestamp.isdecimal() or segment not in self._segments:
            if name in self._segments:  # a bad segment listed by list_unreadable: raise its error
                component_file(self.root, "lidar", name).timestamps()
            remedy = f"Choose a segment from: {abbreviated_list(self._segments)}"
            raise InputError(f"unknown scene {name!r}", str(self.root), remedy)
        return segment, int(timestamp)

    @functools.cached_property
    def _components(self) -> list[str]:
        return names_in(self.root)

    @functools.cached_property
    def _segments(self) -> list[str]:
        return stems_in(self.root / "lidar", ".parquet")

    def _velocity(self, segment: str, timestamp: int) -> tuple[float, float, float] | None:
        """Compute the vehicle's velocity between its poses in this frame and the next (last frame: the previous)."""
        times = component_file(self.root, "vehicle_pose", segment).timestamps()
        other = next((time for time in times if time > timestamp), None) or max(
            (time for time in times if time < timestamp), default=None
        )
        if other is None:
            return None
        now, then = (read_vehicle_pose(self.root, segment, time) for time in (timestamp, other))
        driven = (inverse(now) @ then)[:3, 3] / ((other - timestamp) * 1e-6)
        return (float(driven[0]), float(driven[1]), float(driven[2]))


def _returns(frame: LaserFrame, number: int, offset: NDArray[np.float64]) -> tuple[NDArray[np.generic], ...]:
    """Return points, origins, intensities, no-label zones, pixels and numbers of a laser's first or second returns."""
    image = frame.images[number]
    pixel = np.argwhere(image[..., 0] > 0.0)
    rows, columns = pixel.T
    origins = frame.origins[rows, columns] - offset
    points = origins + image[rows, columns, :1].astype(np.float64) * frame.directions[rows, columns]
    zone = image[rows, columns, 3] > 0.0
    numbers = np.full(len(pixel), number, dtype=np.uint8)
    intensity = image[rows, columns, 1]
    return points.astype(np.float32), origins.astype(np.float32), intensity, zone, pixel.astype(np.int32), numbers


def _no_return(frames: Sequence[LaserFrame], offset: NDArray[np.float64]) -> NoReturnBeams:
    origins, directions = [], []
    for frame in frames:
        empty = ~(frame.images[0][..., 0] > 0.0) & ~(frame.images[1][..., 0] > 0.0)
        origins.append((frame.origins[empty] - offset).astype(np.float32))
        directions.append(frame.directions[empty].astype(np.float32))
    return NoReturnBeams(np.concatenate(origins), np.concatenate(directions))
