"""Mutants of frames in the other recorded formats: OpenPCDet's layout, nuScenes, Argoverse 2, Waymo."""

from __future__ import annotations

import functools
import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
from argoverse2_log import LOG, PERIOD, START, write_log
from feeding import InputKind, register
from mutations import Rng, mutate_bytes, mutate_text, pick, truncate, truncate_a_little
from nuscenes_release import VERSION, write_release
from value_mutations import ARRAYS, ODD_VALUES, mutate_values, write_specials
from waymo_segment import SEGMENT, write_segment

from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes
from shift3d.scenes.nuscenes.scenes import NuScenesScenes
from shift3d.scenes.openpcdet import OpenPcdetScenes
from shift3d.scenes.sets import RecordedScenes
from shift3d.scenes.waymo.scenes import WaymoScenes

FARTHEST_M = 2e4
"""Farthest return: `file_checks.FARTHEST_M` from its sensor, which lies as far from the origin at most."""
LABELS = "12.0 3.0 -0.9 4.5 1.9 1.6 0.3 Car\n8.0 -5.0 -0.8 0.7 0.7 1.8 0.0 Pedestrian\n9 9 -1 1 1 1 0 Bollard\n"


def checked(scenes: RecordedScenes, index: int) -> Any:
    """Load a scene and check what every reader promises. Returns its digest."""
    names = scenes.names()
    scene = scenes.load(names[min(index, len(names) - 1)])
    points, labels = scene.points, scene.labels
    assert points.dtype == np.float32 and points.shape == (len(points), 3) and np.isfinite(points).all()
    assert np.abs(points).max() <= FARTHEST_M and scene.has_beam.any()
    assert np.isfinite(scene.origins).all() and -4.4 <= scene.ground_z_m < 0.0
    assert scene.reflectance is None or ((scene.reflectance >= 0) & (scene.reflectance <= 1)).all()
    assert np.isfinite(labels.boxes).all() and (labels.boxes[:, 3:6] > 0).all()
    assert np.abs(labels.boxes).max(initial=0.0) <= FARTHEST_M
    assert len(labels.classes) == len(labels.names) == len(labels.num_points) == len(labels.boxes)
    assert set(labels.classes) <= {"vehicle", "pedestrian", "cyclist", "other"}
    velocity = scene.conditions.ego_velocity_m_s
    assert velocity is None or (np.abs(velocity) < 1e3).all()
    scenes.source(scene.scene_id)
    return scene.content_hash()


@functools.cache
def _written(write: Callable[[Path], Any]) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="shift3d-fuzz-"))
    write(folder / "set")
    return folder / "set"


def copy_of(write: Callable[[Path], Any]) -> Callable[[Path], None]:
    """Return a writer that copies what another one wrote once."""
    return lambda folder: shutil.copytree(_written(write), folder, dirs_exist_ok=True) and None


# --- OpenPCDet's layout


def write_frames(root: Path) -> None:
    rng = np.random.default_rng(0)
    reach, turn = rng.uniform(3.0, 40.0, 6000), rng.uniform(-np.pi, np.pi, 6000)
    z = np.where(rng.random(6000) < 0.8, -1.7 + rng.normal(0, 0.02, 6000), rng.uniform(-1.7, 2.0, 6000))
    points = np.stack((reach * np.cos(turn), reach * np.sin(turn), z, rng.random(6000)), axis=1).astype(np.float32)
    for part in ("points", "labels", "ImageSets"):
        (root / part).mkdir(parents=True)
    np.save(root / "points" / "000000.npy", points)
    (root / "labels" / "000000.txt").write_text(LABELS)
    (root / "ImageSets" / "val.txt").write_text("000000\n")


def mutate_frames(root: Path, rng: Rng) -> str:
    how = pick(("array", "array", "bytes", "labels", "labels", "split"), rng)
    file = root / "points" / "000000.npy"
    if how == "array":
        np.save(file, pick(ARRAYS, rng)(np.load(file), rng))
    elif how == "bytes":
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))
    else:
        file = root / ("labels/000000.txt" if how == "labels" else "ImageSets/val.txt")
        file.write_bytes(mutate_text(file.read_bytes(), rng))
    return str(how)


# --- nuScenes


def mutate_release(root: Path, rng: Rng) -> str:
    how = pick(("values", "values", "values", "text", "LiDAR"), rng)
    if how == "LiDAR":
        file = pick(sorted(root.rglob("*.pcd.bin")), rng)
        values = np.fromfile(file, "<f4").reshape(-1, 5)
        changed = mutate_bytes(file.read_bytes(), rng) if rng.uniform() < 0.5 else write_specials(values, rng).tobytes()
        file.write_bytes(changed)
        return str(how)
    file = pick(sorted((root / VERSION).glob("*.json")), rng)
    if how == "text":
        file.write_bytes(mutate_text(file.read_bytes(), rng))
    else:
        file.write_text(json.dumps(mutate_values(json.loads(file.read_text()), rng)))
    return f"{file.stem} {how}"


# --- tables of Arrow


def mutate_columns(table: pa.Table, rng: Rng) -> pa.Table:
    """Change a column (removed, renamed, of another type, with gaps or special values), or the rows."""
    how = pick(("drop", "rename", "special", "special", "special", "gap", "odd", "rows", "double", "shuffle"), rng)
    at = int(rng.integers(table.num_columns))
    name, count = table.column_names[at], table.num_rows
    if how == "drop":
        return table.drop_columns([name])
    if how == "rename":
        return table.rename_columns([f"{n}_" if n == name else n for n in table.column_names])
    if how in ("rows", "double", "shuffle"):
        order = {"rows": np.arange(int(rng.integers(count))), "shuffle": rng.permutation(count)}
        return table.take(order.get(how, np.tile(np.arange(count), 2)))
    values = table[name].to_pylist()
    row = int(rng.integers(count))
    if how == "gap":
        values[row] = None
    elif how == "odd":
        values = [pick([odd for odd in ODD_VALUES if not isinstance(odd, dict | list)], rng)] * count
    elif isinstance(values[row], list):
        values[row] = mutate_values(values[row], rng) if rng.uniform() < 0.3 else _special_entry(values[row], rng)
    else:
        values[row] = pick([odd for odd in ODD_VALUES if not isinstance(odd, dict | list)], rng)
    try:
        column = pa.array(values)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):  # no column can hold both kinds of values
        column = pa.array([None if value is None else str(value) for value in values])
    return table.set_column(at, name, column)


def _special_entry(values: list[Any], rng: Rng) -> list[Any]:
    try:
        return list(write_specials(np.array(values, np.float64), rng).tolist())
    except (TypeError, ValueError):
        return []


def table_mutator(
    suffix: str, read: Callable[[Path], pa.Table], write: Callable[[pa.Table, Path], Any]
) -> Callable[[Path, Rng], str]:
    def mutate(root: Path, rng: Rng) -> str:
        file = pick(sorted(root.rglob(f"*{suffix}")), rng)
        if rng.uniform() < 0.35:  # Arrow allocates what a header asks for, so that no length is changed
            damage = pick((truncate, truncate_a_little), rng)
            file.write_bytes(damage(file.read_bytes(), rng))
            return f"{file.parent.name}/{file.name} bytes"
        write(mutate_columns(read(file), rng), file)
        return f"{file.parent.name}/{file.name} columns"

    return mutate


register(
    InputKind(
        "OpenPCDet", 150, write_frames, mutate_frames, lambda root: checked(OpenPcdetScenes(root, split="val"), 0)
    )
)
register(
    InputKind(
        "nuScenes", 200, copy_of(write_release), mutate_release, lambda root: checked(NuScenesScenes(root, sweeps=2), 1)
    )
)
register(
    InputKind(
        "Argoverse 2",
        150,
        copy_of(write_log),
        table_mutator(".feather", lambda file: feather.read_table(file, memory_map=False), feather.write_feather),
        lambda root: checked(Argoverse2Scenes(root, names=[f"{LOG}-{START + PERIOD}"]), 0),
        named=(".feather", "lidar"),
    )
)
register(
    InputKind(
        "Waymo",
        150,
        copy_of(write_segment),
        table_mutator(".parquet", pq.read_table, pq.write_table),
        lambda root: checked(WaymoScenes(root), 1),
        named=(SEGMENT,),
    )
)
