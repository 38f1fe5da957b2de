"""Writer of a suite's files: tables, backgrounds, and temporary files of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from shift3d.store.location import Location
from shift3d.suite.frozen import background_file, blake2b
from shift3d.suite.tables import SUITE_SCHEMAS, suite_table_bytes

Frames = Literal["copied", "referenced"]
SCENE_PREFIX = "unfinished-"  # of temporary files, each with the objects of one scene


@dataclass
class SuiteWriter:
    """Suite being written. key: digest of sweep, choice and frames. digests: of its files. sets: scene sets in use."""

    to: Location
    frames: Frames
    key: str
    digests: dict[str, str] = field(default_factory=dict)
    sets: list[dict[str, Any]] = field(default_factory=list)

    def write(self, name: str, content: bytes) -> None:
        (self.to / name).write_atomic(content)
        self.digests[name] = blake2b(content)

    def scene_file(self, name: str) -> Location:
        """Return the temporary file for the objects of one scene; it is deleted when the suite is complete."""
        return self.to / f"{SCENE_PREFIX}{blake2b(f'{self.key} {name}'.encode())}.parquet"

    def background(self, points: NDArray[np.float32]) -> str:
        """Write a scene's points unless the suite has them. Returns their digest."""
        name = blake2b(np.ascontiguousarray(points, dtype="<f4").tobytes())
        if self.frames == "copied" and background_file(name) not in self.digests:
            columns = [points[:, axis] for axis in range(3)]
            table = pa.Table.from_arrays([pa.array(c) for c in columns], schema=SUITE_SCHEMAS["background"])
            self.write(background_file(name), suite_table_bytes(table))
        return name

    def scene_set(self, settings: Mapping[str, Any]) -> int:
        """Return the index of a scene set's settings; 0 with copied frames, which need no location of a data set."""
        if self.frames == "copied":
            return 0
        if dict(settings) not in self.sets:
            self.sets.append(dict(settings))
        return self.sets.index(dict(settings))
