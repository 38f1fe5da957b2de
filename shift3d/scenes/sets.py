"""Scene sets: names, and the scene behind each name."""

from __future__ import annotations

import functools
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.listing import first_few
from shift3d.scenes.scene import Scene
from shift3d.scenes.street.options import PLAIN, StreetOptions, check_traffic
from shift3d.store.resolve import LocationLike, as_location

if TYPE_CHECKING:
    from shift3d.scenes.facts import SceneFacts
    from shift3d.scenes.street.build.world import PlacedVehicle
    from shift3d.store.location import Location

STREET_SENSORS = ("hdl64", "waymo_top", "mixed")
STREET_SPLITS = ("train", "val", "test")


_STREET = re.compile(r"(street-[a-z]+-([a-z0-9_]+)-\d{6,})(?:-(?!seed\d+$)[a-z0-9._-]+?)?(-seed\d+)?")
_BY_DRIVE = ("waymo", "argoverse2")
"""Data sets whose frames are named "DRIVE-TIMESTAMP"; ten a second are of one drive."""


def place_of(dataset: str, scene: str) -> str:
    """Where a scene of a data set lies, "DATASET/SCENE".

    Scenes of one street lie in one place whatever set they are of, as one of mixed sensors, and whatever options they
    have, as other beams or weather; so do all frames of one segment (Waymo) or log (Argoverse 2). They are no
    independent draws. Names of other recordings tell no drive.
    """
    if found := _STREET.fullmatch(scene):
        return f"street-{found[2]}/{found[1]}{found[3] or ''}"
    drive = scene.rpartition("-")[0] if dataset in _BY_DRIVE else ""
    return f"{dataset}/{drive or scene}"


class SceneSet(Protocol):
    """What tasks read scenes from.

    Attributes:
        dataset: name written into result rows.
        placement_sector_rad: (centre, half width) of the azimuths where objects may be inserted; scenes are labelled
            there.
    """

    @property
    def dataset(self) -> str: ...

    @property
    def placement_sector_rad(self) -> tuple[float, float]: ...

    def names(self) -> list[str]:
        """Scene names, in a fixed order."""
        ...

    def load(self, name: str) -> Scene:
        """The validated scene of a name. Raises InputError: for an unknown name or a bad frame."""
        ...

    def configured(self, name: str) -> tuple[str, SceneFacts] | None:
        """The data set and the facts of a scene, where its configuration alone gives them; None: it must be loaded."""
        ...

    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """Plain values that change whenever the scene's content may: its configuration, or the state of its files."""
        ...


class RecordedScenes(ABC):
    """A `SceneSet` of files: nothing is known of a scene but by these. Objects are placed all around, if not said.

    Args:
        root: folder or bucket.
        names: of the scenes to use, in this order; None: all that are found.
        count: the first so many; those after them are not looked for.
        keep_bad: list scenes that are named and not found, too; loading one raises InputError.
    """

    dataset: str
    placement_sector_rad: tuple[float, float] = (0.0, float(np.pi))

    def __init__(self, root: LocationLike, names: Sequence[str] | None, count: int | None, keep_bad: bool) -> None:
        self.root, self._count, self.keep_bad = as_location(root), count, keep_bad
        self._wanted = None if names is None else list(names)[:count]

    def names(self) -> list[str]:
        """Names of the scenes.

        Raises InputError: files that list them are damaged, an unknown one is wanted, or there are none.
        """
        return list(self._listed)

    @functools.cached_property
    def _listed(self) -> list[str]:
        wanted = self._wanted
        if wanted and self.keep_bad:
            return wanted
        found = list(islice(self._found(), self._count if wanted is None else None))
        if missing := sorted(set(wanted or ()) - set(found)):
            remedy = f"Choose from: {first_few(found)}" if found else "Check its name"
            raise InputError(f"no scene {missing[0]!r}", self._found_in(), remedy)
        listed = found if wanted is None else wanted
        if not listed:
            raise InputError("no scenes", self._found_in(), "Give another folder")
        return listed

    @abstractmethod
    def _found(self) -> Iterable[str]:
        """Names of the scenes that are there, in order; of those that are wanted at least these."""

    @abstractmethod
    def _found_in(self) -> str:
        """Where scenes are looked for, for errors."""

    def _require_listed(self, name: str) -> None:
        """Raises InputError: the set has no scene of this name."""
        if name not in self._listed:
            raise InputError(f"unknown scene {name!r}", str(self.root), f"Choose from: {first_few(self._listed)}")

    def load(self, name: str) -> Scene:
        """One scene. Raises InputError: naming the file, the line, row or key in it, and the remedy."""
        scene = self._read(name)
        scene.validate()
        return scene

    @abstractmethod
    def _read(self, name: str) -> Scene:
        """As `load`, not validated."""

    def configured(self, name: str) -> None:
        """See `SceneSet`: a scene must be loaded."""
        return

    def source(self, name: str) -> tuple[str | int | float | None, ...]:
        """See `SceneSet`: what is said about a scene's files, and where each lies in which version."""
        settings, files = self._made_of(name)
        return (self.dataset, name, *settings, *(f"{file.absolute()}: {file.version()}" for file in files))

    @abstractmethod
    def _made_of(self, name: str) -> tuple[Iterable[str | int | float | None], Iterable[Location]]:
        """What is said about a scene's files, and these."""


def from_one_place(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 3) origins of the beams of points (N, 3) that all start in the scene's origin, a view of one row."""
    return np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape)


class StreetScenes:
    """Procedural street scenes, made when they are asked for.

    Args:
        sensor: "hdl64", "waymo_top", or "mixed" (even indices hdl64, odd ones waymo_top).
        seed: another seed gives other scenes.
        count: how many names the set lists, from index ``start`` on.
        split: "train", "val" or "test": disjoint layouts and vehicles.
        start: first index.
        options: what scenes state and show beyond that; off by default.

    Raises InputError: for an unknown sensor or split, a count below 1, or held-out traffic on split train.
    """

    placement_sector_rad = (0.0, float(np.pi))

    def __init__(
        self,
        sensor: str = "hdl64",
        seed: int = 0,
        count: int = 1,
        split: str = "test",
        start: int = 0,
        options: StreetOptions = PLAIN,
    ) -> None:
        for value, field, choices in ((sensor, "sensor", STREET_SENSORS), (split, "split", STREET_SPLITS)):
            if value not in choices:
                raise InputError(f"unknown {field} {value!r}", "street scenes", f"Choose from {', '.join(choices)}.")
        if count < 1 or start < 0 or seed < 0:
            what = f"count={count}, start={start}, seed={seed}"
            raise InputError(what, "street scenes", "Give count >= 1, start >= 0, seed >= 0.")
        check_traffic(options.traffic, split)
        self.sensor, self.seed, self.count, self.split, self.start = sensor, seed, count, split, start
        self.options = options

    @property
    def dataset(self) -> str:
        """ "street-", the sensor, and the tag of the options that are on."""
        return f"street-{self.sensor}{self.options.tag}"

    def names(self) -> list[str]:
        """Names such as street-test-hdl64-000007; options are appended as -fog50-returns2, a seed other than 0 as
        -seed3 after them."""
        return [self._name(index) for index in range(self.start, self.start + self.count)]

    def load(self, name: str) -> Scene:
        """The scene of a name: the same bytes every time. Its arrays are for reading: others may be given them too."""
        return _made(*self._arguments(name))

    def vehicles(self, name: str) -> tuple[PlacedVehicle, ...]:
        """The vehicles of the scene of a name with their meshes."""
        from shift3d.scenes.street.assemble import street_vehicles

        return street_vehicles(*self._arguments(name))

    def _arguments(self, name: str) -> tuple[str, int, int, str, StreetOptions]:
        match = re.fullmatch(r"street-[a-z]+-[a-z0-9_]+-(\d{6,})(?:-[a-z0-9._-]+)?", name)
        index = int(match[1]) if match else -1
        if not self.start <= index < self.start + self.count or name != self._name(index):
            first, last = self._name(self.start), self._name(self.start + self.count - 1)
            raise InputError(f"unknown scene {name!r}", "street scenes", f"Choose from {first} to {last}.")
        return self.split, self.seed, index, self._sensor_of(index), self.options

    def seen_by_own(self, name: str) -> tuple[StreetScenes, str] | None:
        """The same street seen by its own sensor: set and name; None where it is so already."""
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
        """See `SceneSet`: the name says everything."""
        return ("street", name)

    def _name(self, index: int) -> str:
        tail = self.options.tag + (f"-seed{self.seed}" if self.seed else "")
        return f"street-{self.split}-{self._sensor_of(index)}-{index:06d}{tail}"

    def _sensor_of(self, index: int) -> str:
        return self.sensor if self.sensor != "mixed" else ("hdl64", "waymo_top")[index % 2]


@functools.lru_cache(maxsize=4)
def _made(split: str, seed: int, index: int, sensor: str, options: StreetOptions) -> Scene:
    """A street, validated. It takes half a second to make and 4 MB to keep, and a command may come to one several
    times: in its plan, its tasks, and what follows them."""
    from shift3d.scenes.street.assemble import street_scene

    scene = street_scene(split, seed, index, sensor, options)
    scene.validate()
    return scene
