"""Scene sets: lists of scene names with loaders."""

from __future__ import annotations

import functools
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.file_checks import abbreviated_list
from shift3d.scenes.scene import Scene
from shift3d.scenes.street.options import PLAIN, StreetOptions, check_choice, check_split
from shift3d.store.resolve import LocationLike, as_location

if TYPE_CHECKING:
    from shift3d.scenes.facts import SceneFacts
    from shift3d.scenes.street.build.world import PlacedVehicle
    from shift3d.store.location import Location

STREET_SENSORS = ("hdl64", "waymo_top", "mixed")
_STREET = re.compile(r"(street-[a-z]+-([a-z0-9_]+)-\d{6,})(?:-(?!seed\d+$)[a-z0-9._-]+?)?(-seed\d+)?")
_BY_DRIVE = ("waymo", "argoverse2")
"""Data sets whose frames are named "DRIVE-TIMESTAMP", with ten frames a second of one drive."""


def independent_group_of(dataset: str, scene: str) -> str:
    """Return the place of a scene, "DATASET/PLACE". Scenes of one place are not independent draws.

    All scenes of one street share a place, in any set (such as one of mixed sensors) and with any options (such as
    other beams or weather). So do all frames of one segment (Waymo) or log (Argoverse 2). Scene names of other
    recordings do not tell the drive, so that each scene is its own place.
    """
    if found := _STREET.fullmatch(scene):
        return f"street-{found[2]}/{found[1]}{found[3] or ''}"
    drive = scene.rpartition("-")[0] if dataset in _BY_DRIVE else ""
    return f"{dataset}/{drive or scene}"


class SceneSet(ABC):
    """Source of the scenes of tasks.

    placement_sector_rad: (centre, half width) of the azimuths of insertion; the data set labels scenes there.
    """

    placement_sector_rad: tuple[float, float] = (0.0, float(np.pi))

    @property
    @abstractmethod
    def dataset(self) -> str:
        """Name for result rows."""

    @abstractmethod
    def names(self) -> list[str]:
        """List the scene names, in a fixed order. Raises InputError: damaged files of the list, or no scenes."""

    @abstractmethod
    def load(self, name: str) -> Scene:
        """Load and validate a scene. Raises InputError: an unknown name, or a bad frame: its file, place and remedy."""

    def configured(self, name: str) -> tuple[str, SceneFacts] | None:
        """Return data set and facts of a scene if its configuration alone gives them; None: it must be loaded."""
        return None

    @abstractmethod
    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """Return plain values that change whenever the scene may: its configuration, or the state of its files."""


class RecordedScenes(SceneSet):
    """Scenes of recorded files. A subclass sets `_found_in`, the searched location, if it is not the root.

    Args:
        root: folder or bucket.
        names: scenes to use, each once, in this order; None: all scenes found.
        count: maximum number of scenes; the search stops there.
        list_unreadable: also list named scenes that do not exist; loading one raises InputError.
    """

    dataset: str

    def __init__(
        self, root: LocationLike, names: Sequence[str] | None, count: int | None, list_unreadable: bool
    ) -> None:
        self.root, self._count, self.list_unreadable = as_location(root), count, list_unreadable
        self._wanted = None if names is None else list(dict.fromkeys(names))[:count]
        self._found_in = self.root

    def names(self) -> list[str]:
        """List the names of the scenes.

        Raises InputError: damaged files of the list, an unknown name, or no scenes.
        """
        return list(self._listed)

    @functools.cached_property
    def _listed(self) -> list[str]:
        wanted = self._wanted
        if wanted and self.list_unreadable:
            return wanted
        found = list(islice(self._found(), self._count if wanted is None else None))
        if missing := sorted(set(wanted or ()) - set(found)):
            remedy = f"Choose from: {abbreviated_list(found)}" if found else "Check its name"
            raise InputError(f"no scene {missing[0]!r}", str(self._found_in), remedy)
        listed = found if wanted is None else wanted
        if not listed:
            remedy = "Give another folder" if wanted is None else "Name some in scenes.names, or give null for all"
            raise InputError("no scenes", str(self._found_in), remedy)
        return listed

    @abstractmethod
    def _found(self) -> Iterable[str]:
        """List the existing scenes, in order; may omit scenes that are not wanted."""

    def _require_listed(self, name: str) -> None:
        if name not in self._listed:
            raise InputError(
                f"unknown scene {name!r}", str(self.root), f"Choose from: {abbreviated_list(self._listed)}"
            )

    def load(self, name: str) -> Scene:
        """Load one scene. Raises InputError: naming the file, the line, row or key in it, and the remedy."""
        scene = self._read(name)
        scene.validate()
        return scene

    @abstractmethod
    def _read(self, name: str) -> Scene:
        """Load one scene without validation."""

    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """Return the settings of a scene, and path and version of each of its files; see `SceneSet`."""
        settings, files = self._settings_and_files(name)
        return (self.dataset, name, *settings, *(f"{file.absolute()}: {file.version()}" for file in files))

    @abstractmethod
    def _settings_and_files(self, name: str) -> tuple[Iterable[str | int | float | None], Iterable[Location]]:
        """Return the settings and the files of a scene."""


def shared_origins(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return origins (N, 3) for beams of points (N, 3) that all start at the scene's origin, a view of one row."""
    return np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape)


class StreetScenes(SceneSet):
    """Procedural street scenes, generated on demand.

    Args:
        sensor: "hdl64", "waymo_top", or "mixed" (even indices hdl64, odd ones waymo_top).
        seed: another seed gives other scenes.
        count: number of names in the set, from index ``start`` on.
        split: "train", "val" or "test": disjoint layouts and vehicles.
        start: first index.
        options: optional properties of the scenes; off by default.

    Raises InputError: an unknown sensor or split, a count below 1, or held-out traffic on split train.
    """

    def __init__(
        self,
        sensor: str = "hdl64",
        seed: int = 0,
        count: int = 1,
        split: str = "test",
        start: int = 0,
        options: StreetOptions = PLAIN,
    ) -> None:
        check_choice("sensor", sensor, STREET_SENSORS)
        check_split(split, options.traffic)
        if count < 1 or start < 0 or seed < 0:
            what = f"count={count}, start={start}, seed={seed}"
            raise InputError(what, "street scenes", "Give count >= 1, start >= 0, seed >= 0.")
        self.sensor, self.seed, self.count, self.split, self.start = sensor, seed, count, split, start
        self.options = options

    @property
    def dataset(self) -> str:
        """Name "street-", the sensor, and the tag of the options that are on."""
        return f"street-{self.sensor}{self.options.tag}"

    def names(self) -> list[str]:
        """List names such as street-test-hdl64-000007, with options (-fog50-returns2) and nonzero seed (-seed3)."""
        return [self._name(index) for index in range(self.start, self.start + self.count)]

    def load(self, name: str) -> Scene:
        """Return the scene of a name, the same bytes every time. Do not change its arrays: callers share them."""
        return _made(*self._arguments(name))

    def vehicles(self, name: str) -> tuple[PlacedVehicle, ...]:
        """Return the vehicles of the scene of a name, with their meshes."""
        from shift3d.scenes.street.assemble import street_vehicles

        return street_vehicles(*self._arguments(name))

    def _arguments(self, name: str) -> tuple[str, int, int, str, StreetOptions]:
        match = re.fullmatch(r"street-[a-z]+-[a-z0-9_]+-(\d{6,})(?:-[a-z0-9._-]+)?", name)
        index = int(match[1]) if match else -1
        if not self.start <= index < self.start + self.count or name != self._name(index):
            first, last = self._name(self.start), self._name(self.start + self.count - 1)
            raise InputError(f"unknown scene {name!r}", "street scenes", f"Choose from {first} to {last}.")
        return self.split, self.seed, index, self._sensor_of(index), self.options

    def with_own_sensor(self, name: str) -> tuple[StreetScenes, str] | None:
        """Return set and name of the same street seen by its own sensor; None if options.beams is None."""
        if self.options.beams is None:
            return None
        options = replace(self.options, beams=None)
        own = StreetScenes(self.sensor, self.seed, self.count, self.split, self.start, options)
        return own, own._name(int(name.split("-")[3]))

    def configured(self, name: str) -> tuple[str, SceneFacts] | None:
        from shift3d.scenes.street.assemble import street_facts

        sensor = self._sensor_of(int(name.split("-")[3]))
        return f"street-{sensor}{self.options.tag}", street_facts(name, sensor, self.options)

    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """Return the name, which determines the scene; see `SceneSet`."""
        return ("street", name)

    def _name(self, index: int) -> str:
        tail = self.options.tag + (f"-seed{self.seed}" if self.seed else "")
        return f"street-{self.split}-{self._sensor_of(index)}-{index:06d}{tail}"

    def _sensor_of(self, index: int) -> str:
        return self.sensor if self.sensor != "mixed" else ("hdl64", "waymo_top")[index % 2]


@functools.lru_cache(maxsize=4)
def _made(split: str, seed: int, index: int, sensor: str, options: StreetOptions) -> Scene:
    """Generate and validate a street in half a second. Cached (4 MB each): plan, tasks and later steps may share it."""
    from shift3d.scenes.street.assemble import street_scene

    scene = street_scene(split, seed, index, sensor, options)
    scene.validate()
    return scene
