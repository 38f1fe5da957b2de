"""A solution turned back into things: the edited scene, the vehicle's mesh, its box, and which points moved."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.attack.objective import object_box
from shift3d.geometry.se3 import scene_from_object
from shift3d.render.rendering import Rendering
from shift3d.scenes.scene import Scene
from shift3d.store.atomic import write_atomic
from shift3d.task.assets import Assets
from shift3d.task.run import build_problem
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.vehicle import vehicle_mesh

_POSE = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")


def export_solution(spec: TaskSpec, solution: Mapping[str, Any], assets: Assets, folder: Path) -> list[Path]:
    """Render one row of ``solutions.parquet`` again and write what it is.

    Args:
        spec: the row's task. assets: that the task ran with.
        solution: latent_code (256,), the six pose columns, method, replicate.
        folder: made if absent; each file is written whole or not at all.

    Returns:
        The files: ``scene.bin`` (KITTI: float32 x, y, z, reflectance; sensor frame; the scene's point order;
        reflectance 0 where the scene has none), ``object.ply`` (metres, sensor frame), ``box.json`` (sensor frame,
        geometric centre) and ``hit_mask.npy`` (bool, True where a point was moved onto the object). Points that
        effects made vanish are left out of both; returns of beams that had none follow the scene's points.

    Raises:
        InputError: a scene or vehicle that cannot be loaded, or a folder that cannot be written.
    Source: design section 5.
    """
    scene, _ = assets.scene(spec)
    vehicle = assets.vehicle(spec)
    theta = torch.tensor([solution[name] for name in _POSE], dtype=torch.float64)
    problem = build_problem(spec, assets, theta)
    code = torch.tensor(np.asarray(solution["latent_code"], dtype=np.float32)).to(problem.settings.dtype)
    with torch.no_grad():
        rendering = problem.insert(code, theta)
    mesh = vehicle_mesh(vehicle, assets.decoder, code.float())
    mesh.vertices = scene_from_object(torch.from_numpy(np.array(mesh.vertices)), theta).numpy()
    kept = slice(None) if rendering.returned is None else rendering.returned.numpy()
    hits = rendering.hit_mask.numpy()[kept]
    files = {
        "scene.bin": _kitti_bytes(rendering.points.numpy()[kept], _reflectance(scene, rendering, kept)),
        "object.ply": _ply_bytes(mesh),
        "box.json": _box_json(spec, solution, theta, vehicle.size_m, int(hits.sum())),
        "hit_mask.npy": _npy_bytes(hits),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_atomic(folder / name, content)
    return [folder / name for name in files]


def _reflectance(scene: Scene, rendering: Rendering, kept: slice | NDArray[np.bool_]) -> NDArray[np.float32] | None:
    """Of every point that is written: as effects left it, else the scene's; 0 for beams that had no return."""
    if rendering.reflectance is not None:
        return rendering.reflectance.numpy()[kept].astype(np.float32)
    if scene.reflectance is None:
        return None
    values = np.zeros(len(rendering.points), dtype=np.float32)
    values[: len(scene.reflectance)] = scene.reflectance
    return values[kept]


def _kitti_bytes(points: NDArray[np.float32], reflectance: NDArray[np.float32] | None) -> bytes:
    rows = np.zeros((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    if reflectance is not None:
        rows[:, 3] = reflectance
    return rows.tobytes()


def _box_json(
    spec: TaskSpec,
    solution: Mapping[str, Any],
    theta: torch.Tensor,
    size_m: tuple[float, float, float],
    object_points: int,
) -> bytes:
    numbers = (float(value) for value in object_box(theta, size_m, 0.0))
    names = ("x", "y", "z", "dx", "dy", "dz", "heading")
    what = {
        "box": dict(zip(names, numbers, strict=True)),
        "frame": "lidar",
        "units": "metres, radians; geometric centre; heading counter-clockwise from +x",
        "class": "vehicle",
        "pose": {name: float(solution[name]) for name in _POSE},
        "object_points": object_points,
        "task_id": spec.task_id,
        "vehicle": spec.vehicle,
        "scene": spec.scene,
        "method": solution["method"],
        "replicate": int(solution["replicate"]),
    }
    return (json.dumps(what, indent=2, sort_keys=True) + "\n").encode()


def _npy_bytes(array: NDArray[np.bool_]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _ply_bytes(mesh: trimesh.Trimesh) -> bytes:
    content = mesh.export(file_type="ply")
    assert isinstance(content, bytes)
    return content
