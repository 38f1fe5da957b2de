"""Suite in a folder or bucket: its manifest, its objects, and the scene of each object as detectors see it.

DIR/suite.json                the selection, the digest of every file, and the digest of the whole suite
DIR/objects.parquet           the objects: box, pose, latent code, and the points that they change
DIR/scores.parquet            scores of the objects by the sweep's detectors
DIR/backgrounds/HASH.parquet  a scene without the object, stored once for all of its objects (frames=copied)
DIR/releases/00000001.parquet the scores of accepted releases; no part of the digest
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.settings.schema.scenes import scene_config, scene_set
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.suite.tables import SUITE_VERSION, read_suite_table

if TYPE_CHECKING:
    import pandas as pd

    from shift3d.scenes.sets import SceneSet

_CHANGED = "Restore it from a copy, or freeze the suite again: scores on other objects cannot be compared"
BOX = ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")  # columns of an object's box, scene frame


def blake2b(content: bytes) -> str:
    """Compute the 128-bit BLAKE2b digest, hex."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def background_file(background: str) -> str:
    """Return the path of a background inside its suite."""
    return f"backgrounds/{background}.parquet"


def manifest_bytes(manifest: Mapping[str, Any]) -> bytes:
    """Serialize suite.json: the manifest with its digest, which covers the digests of all files."""
    plain = {key: value for key, value in manifest.items() if key != "digest"}
    canonical = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return (json.dumps({**plain, "digest": blake2b(canonical.encode())}, indent=1, sort_keys=True) + "\n").encode()


@dataclass
class FrozenSuite:
    """Suite whose bytes equal the frozen ones.

    manifest: suite.json. objects: one row per object, in the suite's order. root: folder of referenced frames, if they
    were elsewhere when the suite was frozen.
    """

    folder: Location
    manifest: dict[str, Any]
    objects: pd.DataFrame
    root: str | None = None
    _sets: dict[int, SceneSet] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Digest of everything that is scored."""
        return str(self.manifest["digest"])

    def background(self, name: str) -> NDArray[np.float32]:
        """Return points (N, 3) of a scene without the object, scene frame, metres.

        Raises: InputError: the file or frame is missing, or differs from the frozen one.
        """
        if self.manifest["frames"] == "copied":
            file = self.folder / background_file(name)
            content = _checked(file, self.manifest["files"][background_file(name)])
            table = read_suite_table(file, "background", content)
            return np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
        row = self.objects[self.objects["background"] == name].iloc[0]
        scene = self._frames(int(row["frames"])).load(row["scene"])
        if scene.content_hash() != row["scene_hash"]:
            remedy = "Give root=PATH of the same data, or freeze the suite again"
            raise InputError("differs from the frame that the suite was frozen with", f"scene {row['scene']}", remedy)
        return scene.points

    def _frames(self, number: int) -> SceneSet:
        if number not in self._sets:
            values = dict(self.manifest["scene_sets"][number])
            if "root" in values:  # the sweep may have been limited to fewer frames
                values |= {"root": self.root or values["root"], "count": None}
            self._sets[number] = scene_set(scene_config(values))
        return self._sets[number]

    def points_of(self, row: Mapping[str, Any], background: NDArray[np.float32]) -> NDArray[np.float32]:
        """Build the scene (M, 3) with an object in it, from the object's row and its background."""
        new = np.asarray(row["points"], dtype=np.float32).reshape(-1, 3)
        rows = np.asarray(row["rows"], dtype=np.int64)
        points = background.copy()
        points[rows] = new[: len(rows)]
        return np.concatenate((points, new[len(rows) :]))


def box_of(row: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the object's box (7,) in the network frame: z measured from the ground."""
    box = np.array([float(row[name]) for name in BOX])
    box[2] -= float(row["ground_z_m"])
    return box


def read_suite(folder: LocationLike, root: str | None = None) -> FrozenSuite:
    """Read the suite of a folder or bucket, and compare every file's bytes with its digest. root: see `FrozenSuite`.

    Raises: InputError: no suite, one of another version, or a file that is missing or changed; the file is named.
    """
    folder = as_location(folder)
    path = folder / "suite.json"
    manifest = read_manifest(path)
    digest = json.loads(manifest_bytes(manifest))["digest"]
    if digest != manifest.get("digest") or "objects.parquet" not in manifest.get("files", {}):
        raise InputError("was changed after the suite was frozen", str(path), _CHANGED)
    for name, digest in manifest["files"].items():
        _checked(folder / name, digest)
    objects = read_suite_table(folder / "objects.parquet", "objects").to_pandas()
    if objects.empty:
        raise InputError("contains no object", str(folder), "Freeze a suite of a sweep that found hard objects")
    return FrozenSuite(folder, manifest, objects, root)


def read_manifest(path: Location) -> dict[str, Any]:
    """Read suite.json. Raises InputError: it is missing, or has another format."""
    try:
        manifest = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        remedy = "Give suite=DIR of a folder that shift3d suite wrote"
        raise InputError("no such suite", str(path), remedy) from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot be read ({type(error).__name__})", str(path), _CHANGED) from error
    version = manifest.get("version") if isinstance(manifest, dict) else None
    if version != SUITE_VERSION:
        what = f"is a suite of version {str(version)[:20]}; this program reads version {SUITE_VERSION}"
        remedy = "Use the version of shift3d that wrote it, or freeze the suite again"
        raise InputError(what, str(path), remedy)
    return dict(manifest)


def _checked(file: Location, digest: str) -> bytes:
    """Return a file's bytes. Raises InputError: the file is missing, or its bytes have changed."""
    try:
        content = file.read_bytes()
    except FileNotFoundError as error:
        raise InputError("is missing", str(file), _CHANGED) from error
    if blake2b(content) != digest:
        raise InputError("was changed after the suite was frozen", str(file), _CHANGED)
    return content
