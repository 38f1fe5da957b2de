"""Map of a log in the city frame: a raster of ground heights, and outlines of drivable areas."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse, moved
from shift3d.scenes.file_checks import names_in, opened, read_array
from shift3d.scenes.ground_map import GroundMap
from shift3d.store.location import Location

Float = NDArray[np.float64]

_HEIGHTS, _RASTER, _OUTLINES = "_ground_height_surface____", "___img_Sim2_city.json", "log_map_archive_"
_REACH_M = 90.0  # half side of the raster's part that is read; reaches the corners of the scene's map
_AGAIN = "Copy the log's map/ again, or remove the folder"


def map_files(log: Location) -> list[Location]:
    """List a log's map files that scenes use, in order of name; none if the log has no map."""
    known = [name for name in names_in(log / "map") if _HEIGHTS in name or _RASTER in name or _OUTLINES in name]
    return [log / "map" / name for name in sorted(known)]


def read_ground_map(log: Location, city_SE3_scene: Float) -> GroundMap | None:
    """Read the ground around a scene: heights, drivable areas, or both. Returns None if the log has no map.

    city_SE3_scene: (4, 4), metres. Raises InputError: a damaged file, or heights without the raster's transform.
    """
    files = map_files(log)
    by_kind = {kind: [file for file in files if kind in file.name] for kind in (_HEIGHTS, _RASTER, _OUTLINES)}
    ground, areas = np.zeros((0, 3)), None
    if by_kind[_HEIGHTS]:
        if not by_kind[_RASTER]:
            raise InputError(f"no *{_RASTER}, which places the heights", str(log / "map"), _AGAIN)
        ground = _heights(by_kind[_HEIGHTS][0], by_kind[_RASTER][0], city_SE3_scene[:2, 3])
    if by_kind[_OUTLINES]:
        areas = _outlines(by_kind[_OUTLINES][0])
    if areas is None and not len(ground):
        return None
    scene_SE3_city = inverse(city_SE3_scene)
    there = None if areas is None else [moved(outline, scene_SE3_city) for outline in areas]
    return GroundMap.of(moved(ground, scene_SE3_city), there)


def _heights(file: Location, placed_by: Location, centre_m: Float) -> Float:
    """Read the raster's cell centres (N, 3) around (x, y), city frame. raster = s (R city + t), truncated."""
    raster = read_array(file)
    values = _json(placed_by)
    try:
        rotation, shift = (np.array(values[name], dtype=np.float64) for name in "Rt")
        scale = float(values["s"])
        with np.errstate(over="ignore", invalid="ignore"):
            column, row = scale * (rotation.reshape(2, 2) @ centre_m + shift)
        if not np.isfinite([column, row]).all():
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError("no R of 4 numbers, t of 2 and s, all finite", str(placed_by), _AGAIN) from error
    if raster.ndim != 2 or not scale > 0.0:
        what = f"an array of {raster.dtype}, shape {raster.shape}, at scale {scale}"
        raise InputError(what, str(file), _AGAIN)
    reach = _REACH_M * scale
    rows, columns = (
        np.arange(*np.clip((middle - reach, middle + reach), 0, size).astype(np.int64))
        for middle, size in ((row, raster.shape[0]), (column, raster.shape[1]))
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2) + 0.5
    city = (pixels / scale - shift) @ rotation.reshape(2, 2)
    return np.column_stack((city, raster[np.ix_(rows, columns)].reshape(-1).astype(np.float64)))


def _outlines(file: Location) -> list[Float]:
    """Read the outlines of drivable areas, (V, 3) each, city frame."""
    try:
        areas = _json(file)["drivable_areas"].values()
        found = [
            np.array([[point[axis] for axis in "xyz"] for point in area["area_boundary"]], dtype=np.float64)
            for area in areas
        ]
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise InputError("no drivable_areas of area_boundary points x, y, z", str(file), _AGAIN) from error
    if any(outline.ndim != 2 or not np.isfinite(outline).all() for outline in found):
        raise InputError("an outline without finite points", str(file), _AGAIN)
    return found


def _json(file: Location) -> dict[str, Any]:
    with opened(file, "JSON file", ValueError, RecursionError) as handle:
        values = json.loads(handle.read())
    if not isinstance(values, dict):
        raise InputError("no JSON object", str(file), _AGAIN)
    return values
