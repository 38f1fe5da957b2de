"""SDF grids of unchanged vehicles in the user's cache folder: 90,000 evaluations a vehicle, taken once a machine.

A grid from there has the bytes that this process would compute: its name changes with the decoder, the vehicle, the
settings, the code that makes grids and what decides rounding on this machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open

from shift3d.errors import InputError
from shift3d.processor import rounding
from shift3d.render.culling import Box
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import RenderSettings
from shift3d.store.arrays import write_safetensors
from shift3d.store.user_cache import source_digest, user_cache

FILES_KEPT = 256
"""Of 750 kB each; the oldest make room."""
_CODE = ("render", "sdf", "processor.py", "task/kept_grids.py")


def kept_grid(decoder_hash: str, vehicle_hash: str, settings: RenderSettings, make: Callable[[], SdfGrid]) -> SdfGrid:
    """The grid of a vehicle at these settings, from the cache folder; made, and kept there, where it holds none.

    A file that is torn or changed is made again; a folder that cannot be written is done without.
    """
    path = _file(decoder_hash, vehicle_hash, settings)
    try:
        return _read(path)
    except (OSError, SafetensorError, KeyError, ValueError):
        grid = make()
        with contextlib.suppress(InputError, OSError):
            _write(path, grid)
            _make_room(path.parent)
        return grid


def _file(decoder_hash: str, vehicle_hash: str, settings: RenderSettings) -> Path:
    made_of = (decoder_hash, vehicle_hash, repr(settings), source_digest(*_CODE), rounding())
    return user_cache() / "grids" / f"{hashlib.blake2b(repr(made_of).encode(), digest_size=16).hexdigest()}.safetensors"


def _write(path: Path, grid: SdfGrid) -> None:
    tensors = {"lower": grid.box.lower, "upper": grid.box.upper, "distance_m": grid.distance_m}
    tensors |= {f"live {layer}": units for layer, units in enumerate(grid.live or ())}
    facts = json.dumps([float(grid.error_m).hex(), grid.evaluations, grid.live is not None])
    write_safetensors(path, tensors, {"facts": facts, "digest": _digest(tensors, facts)})


def _read(path: Path) -> SdfGrid:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
        names: list[str] = list(file.keys())
        tensors = {name: file.get_tensor(name) for name in names}
    if _digest(tensors, metadata["facts"]) != metadata["digest"]:
        raise ValueError("its bytes have changed")
    error_m, evaluations, has_live = json.loads(metadata["facts"])
    live = tuple(tensors[f"live {layer}"] for layer in range(len(tensors) - 3)) if has_live else None
    box = Box(tensors["lower"], tensors["upper"])
    return SdfGrid(box, tensors["distance_m"], float.fromhex(error_m), evaluations, live)


def _make_room(folder: Path) -> None:
    """Remove the oldest files beyond those that are kept; other processes may do the same."""
    written: dict[Path, float] = {}
    for file in folder.glob("*.safetensors"):
        with contextlib.suppress(FileNotFoundError):
            written[file] = file.stat().st_mtime
    for file in sorted(written, key=written.__getitem__)[:-FILES_KEPT]:
        file.unlink(missing_ok=True)


def _digest(tensors: dict[str, torch.Tensor], facts: str) -> str:
    digest = hashlib.blake2b(facts.encode(), digest_size=16)
    for name in sorted(tensors):
        values = tensors[name].contiguous().numpy()
        digest.update(f"{name} {values.dtype} {values.shape}".encode() + values.tobytes())
    return digest.hexdigest()
