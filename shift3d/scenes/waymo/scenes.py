"""Frames of the Waymo Open Dataset, version 2, as scenes."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.labels import Conditions, Labels
from shift3d.scenes.listing import chosen, first_few, names_in, require_metres
from shift3d.scenes.scene import Scene
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
from shift3d.store.resolve import LocationLike, as_location

COMPONENTS = ("lidar", "lidar_calibration", "lidar_pose", "vehicle_pose")
"""What a frame is made of. A folder may lack labels (`lidar_box`) and weather (`stats`), a segment of it may not."""
_OPTIONAL = ("lidar_box", "stats")
_SEGMENTS_AT_ONCE = 16


class WaymoScenes(RecordedScenes):
    """Frames under a folder or bucket with ``{component}/{segment}.parquet``.

    Args:
        root: holds lidar/, lidar_calibration/, lidar_pose/, vehicle_pose/, and lidar_box/ and stats/ where there are
            labels and weather.
        names: ``SEGMENT-TIMESTAMP`` of the frames to use; None: every frame, in order.
        count: the first so many; those after them are not looked for.
        lasers: which sensors: names of `LASERS`.
        every: of each segment every n-th frame, of those that are not named.
        keep_bad: list a segment whose frames cannot be listed under its own name; loading it raises InputError.

    A scene's origin is the TOP laser (its axes are the vehicle's), whether or not that laser is used. Points are laser
    by laser, first returns, then second ones, row by row of each range image; those without a range are left out and
    are, where neither return has one, `Scene.no_return`. Every beam starts where its own pixel's pose puts its
    sensor. Points are motion compensated, to the frame's time. No firing times are stated by the data set. Reflectance
    is tanh of the intensity, which has no upper limit: the scale that detectors of this data set are trained on.

    Raises InputError: no component lidar/, an unknown laser, or one twice.
    """

    dataset = "waymo"

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        lasers: Sequence[str] = tuple(LASERS),
        every: int = 1,
        keep_bad: bool = False,
    ) -> None:
        self.root = as_location(root)
        self.lasers, self.every, self.keep_bad, self._count = tuple(lasers), every, keep_bad, count
        unknown = [name for name in lasers if name not in LASERS]
        if unknown or not lasers:
            raise InputError(
                f"unknown laser {(unknown or ['none at all'])[0]!r}", "Waymo", f"Known: {', '.join(LASERS)}"
            )
        if len(set(self.lasers)) < len(self.lasers):
            what = f"a laser twice in scenes.lasers=[{','.join(self.lasers)}]"
            raise InputError(what, "Waymo", "Name each laser once")
        self._wanted = None if names is None else list(names)[:count]
        if "lidar" not in self._names_in(self.root):
            raise InputError(
                "no component lidar/", str(self.root), "Give the folder that holds lidar/, lidar_pose/, ..."
            )

    def _read(self, name: str) -> Scene:
        segment, timestamp = self._split(name)
        frames = read_frame(self.root, segment, timestamp, self.lasers)
        offset = self._origin(segment)
        where = f"{component_file(self.root, 'lidar', segment).file}, frame {timestamp}"
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
            labels=read_labels(self.root, segment, timestamp, points, offset) if self._has("lidar_box") else Labels(),
            reflectance=np.tanh(np.maximum(intensity, 0.0)),
            return_number=number,
            range_image_index=pixel,
            conditions=self._conditions(segment, timestamp),
            no_return=_no_return(frames, offset),
            in_no_label_zone=zone,
        )

    def _made_of(self, name: str) -> tuple[Sequence[str], list[Location]]:
        segment, parts = name.rpartition("-")[0] or name, (*COMPONENTS, *_OPTIONAL)
        return self.lasers, [component_file(self.root, part, segment).file for part in parts]

    @functools.cached_property
    def _listed(self) -> list[str]:  # type: ignore[override]
        segments = self._segments()
        if self._wanted is not None:
            requested = {name.rpartition("-")[0] or name for name in self._wanted}
            segments = [segment for segment in segments if segment in requested]
            if self.keep_bad:
                return list(self._wanted)
        return chosen(self._frames(segments), self._wanted, str(self.root / "lidar"), self._count)

    def _frames(self, segments: Sequence[str]) -> Iterator[str]:
        """Names of the frames of segments, some segments at a time."""
        for start in range(0, len(segments), _SEGMENTS_AT_ONCE):
            for names in self.root.each(self._frames_of, segments[start : start + _SEGMENTS_AT_ONCE]):
                yield from names

    def _frames_of(self, segment: str) -> list[str]:
        try:
            timestamps = component_file(self.root, "lidar", segment).timestamps()
        except InputError:
            if not self.keep_bad:
                raise
            return [segment]
        return [f"{segment}-{timestamp}" for timestamp in timestamps[:: self.every if self._wanted is None else 1]]

    def _split(self, name: str) -> tuple[str, int]:
        segment, _, timestamp = name.rpartition("-")
        if not timestamp.isdecimal() or not segment or segment not in self._segments():
            if name in self._segments():  # listed although it is bad: say now what is wrong with it
                component_file(self.root, "lidar", name).timestamps()
            raise InputError(f"unknown scene {name!r}", str(self.root), f"Segments: {first_few(self._segments())}")
        return segment, int(timestamp)

    def _segments(self) -> list[str]:
        files = self._names_in(self.root / "lidar")
        return [name.removesuffix(".parquet") for name in files if name.endswith(".parquet")]

    def _names_in(self, folder: Location) -> list[str]:
        """What lies in a folder, asked once."""
        if str(folder) not in self._folders:
            self._folders[str(folder)] = names_in(folder)
        return self._folders[str(folder)]

    @functools.cached_property
    def _folders(self) -> dict[str, list[str]]:
        return {}

    def _has(self, component: str) -> bool:
        return component in self._names_in(self.root)

    def _origin(self, segment: str) -> NDArray[np.float64]:
        """(3,) the TOP laser in the vehicle frame, metres: where scenes have their origin."""
        found = read_calibrations(self.root, segment)
        if LASERS["TOP"] not in found:
            of = str(component_file(self.root, "lidar_calibration", segment).file)
            raise InputError("no row of laser 1 (TOP)", of, "Copy it again")
        return found[LASERS["TOP"]].vehicle_SE3_laser[:3, 3]

    def _conditions(self, segment: str, timestamp: int) -> Conditions:
        weather = read_weather(self.root, segment, timestamp) if self._has("stats") else "dry"
        return Conditions(weather=weather, ego_velocity_m_s=self._velocity(segment, timestamp))

    def _velocity(self, segment: str, timestamp: int) -> tuple[float, float, float] | None:
        """Of the vehicle, from its pose to that of the frame after it (of the last one: before it)."""
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
    """Points, origins, intensities, no-label zones, pixels and return numbers of a laser's first or second returns."""
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
