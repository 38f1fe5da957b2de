"""Meshes of the wide family as files, for a decoder whose codes lie as dense as its vehicles."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm
from trimesh.exchange.ply import export_ply

from shift3d.store.atomic import write_atomic
from shift3d.vehicles.family.wide import Side, build_wide_mesh, wide_vehicle
from shift3d.vehicles.mesh_frame import MeshFrame

__all__ = ["WIDE_FRAME", "samples_a_shape", "write_wide_meshes"]

WIDE_FRAME = MeshFrame(forward="+x", up="+z", unit="m")
RESOLUTION_M, FACES = 0.03, 30_000
SEED = 7
SAMPLES, MOST_A_SHAPE = 20_000_000, 100_000
"""Samples of all shapes together, 320 MB, and of one at most (our choice)."""


def samples_a_shape(count: int) -> int:
    """How many samples each of `count` shapes gets."""
    return max(min(MOST_A_SHAPE, SAMPLES // count), 1_000)


def write_wide_meshes(out: Path, count: int, side: Side = "seen") -> Path:
    """The first `count` vehicles of a side of the split as PLY, named by kind and index; those that are there stay.

    Returns the folder, which is below `out` and holds nothing else.
    Raises: InputError for an unknown side, a full disk or a folder that cannot be written.
    """
    folder = out / f"wide-{side}-{count}"
    for index in tqdm(range(count), desc="building meshes", mininterval=5.0):
        spec = wide_vehicle(index, SEED, side)
        file = folder / f"{spec.kind.replace('+', '-')}-{index:05d}.ply"
        if not file.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            mesh = build_wide_mesh(spec, RESOLUTION_M, FACES)
            write_atomic(file, export_ply(mesh))
    return folder
