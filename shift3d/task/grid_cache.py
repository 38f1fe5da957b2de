"""Disk cache of SDF grids of unchanged vehicles, in the user's cache folder: saves 90,000 evaluations per vehicle.

A cached grid has the bytes that this process would compute: its file name depends on the decoder, the vehicle, the
settings, the code that makes grids, and everything that decides rounding on the machine.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import torch
from safetensors.torch import load, save

from shift3d.render.culling import Box
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import RenderSettings
from shift3d.store.user_cache import cache_file, cache_result, read_cached, source_digest

FILES_KEPT = 256
"""Maximum number of files, 750 kB each; the oldest are deleted."""
_CODE = ("render", "sdf", "processor.py", "task/grid_cache.py")


def cached_grid(decoder_hash: str, vehicle_hash: str, settings: RenderSettings, make: Callable[[], SdfGrid]) -> SdfGrid:
    """Return the grid of a vehicle at these settings from the cache folder; compute and store it if it is missing.

    A damaged file is computed again. A folder that cannot be written is not used.
    """
    file = cache_file("grids", decoder_hash, vehicle_hash, settings, source_digest(*_CODE))
    if (content := read_cached(file)) is not None:
        return _grid(load(content))
    grid = make()
    cache_result(file, save(_tensors(grid)))
    _make_room(file.parent)
    return grid


def _tensors(grid: SdfGrid) -> dict[str, torch.Tensor]:
    tensors = {"lower": grid.box.lower, "upper": grid.box.upper, "distance_m": grid.distance_m}
    tensors["error_m"] = torch.tensor(grid.error_m, dtype=torch.float64)
    tensors["evaluations"] = torch.tensor(grid.evaluations)
    if grid.live is not None:
        tensors["layers"] = torch.tensor(len(grid.live))
    return tensors | {f"live {layer}": units for layer, units in enumerate(grid.live or ())}


def _grid(tensors: dict[str, torch.Tensor]) -> SdfGrid:
    live = tuple(tensors[f"live {layer}"] for layer in range(int(tensors["layers"]))) if "layers" in tensors else None
    box = Box(tensors["lower"], tensors["upper"])
    return SdfGrid(box, tensors["distance_m"], float(tensors["error_m"]), int(tensors["evaluations"]), live)


def _make_room(folder: Path) -> None:
    """Delete the oldest files beyond the limit, unless another process is quicker or this user may not delete them."""
    written: dict[Path, float] = {}
    for file in folder.glob("[!.]*"):
        with contextlib.suppress(FileNotFoundError):
            written[file] = file.stat().st_mtime
    for file in sorted(written, key=written.__getitem__)[:-FILES_KEPT]:
        with contextlib.suppress(OSError):
            file.unlink()
