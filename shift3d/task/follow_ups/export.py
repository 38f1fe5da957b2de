"""Export of a solution: the edited scene, the vehicle's mesh, its bounding box, and the mask of moved points."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.attack.objective import object_box
from shift3d.errors import InputError
from shift3d.geometry.se3 import scene_from_object
from shift3d.render.rendering import Rendering
from shift3d.scenes.kitti.writing import frame_files, velodyne_bytes
from shift3d.scenes.scene import Scene
from shift3d.store.atomic import write_atomic
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.task.assets import Assets
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.vehicle import vehicle_mesh

FRAME = "000000"
"""Name of the exported frame in its KITTI folder."""
_BOX = ("x", "y", "z", "dx", "dy", "dz", "heading")
_UNITS = "metres, radians; geometric centre; heading counter-clockwise from +x, -pi to pi"
_OBJECT_RGBA, _SCENE_RGBA = (213, 94, 0, 255), (140, 140, 140, 255)


_FILES = ("scene.bin", "scene.ply", "hit_mask.npy", "object.ply", "object.glb", "box.json", "boxes.json")
_KITTI = "kitti"


def check_no_export(folder: Path) -> None:
    """Raise InputError if an export would replace files of the folder."""
    taken = [name for name in (*_FILES, _KITTI) if (folder / name).exists()]
    if taken:
        what = f"{taken[0]} is there already, and an export would replace it"
        raise InputError(what, where=str(folder), remedy="Give another to=DIR, or overwrite=true")


def export_solution(spec: TaskSpec, solution: Mapping[str, Any], assets: Assets, folder: Path) -> list[Path]:
    """Render one row of ``solutions.parquet`` again and write the export files.

    Args:
        spec: the row's task. assets: those of the task's run.
        solution: latent_code (256,), the six pose columns, method, replicate.
        folder: created if absent; each file is written whole or not at all.
    Returns: The files. ``scene.bin`` (KITTI: float32 x, y, z, reflectance; sensor frame; the scene's point order;
    reflectance 0 if the scene has none) and ``scene.ply`` (the same points, the vehicle's coloured), ``hit_mask.npy``
    (bool, True for points moved onto the object), ``object.ply`` (metres, sensor frame) and ``object.glb`` (the
    vehicle's own frame in glTF's axes, y up and z forward), ``box.json`` (sensor frame, geometric centre: ``own_box``
    is the mesh's; ``box``, used by the attack and the scores, has the unchanged vehicle's size), ``boxes.json`` (all
    objects in the scene, the object's own box last), and ``kitti/training/...``, the edited scene as a frame of a KITTI
    folder. Points that effects removed are left out; returns on beams that had no return follow the scene's points.
    Raises: InputError: a scene or vehicle that cannot be loaded, or a folder that cannot be written.
    Source: design section 5.
    """
    scene, _ = assets.scene(spec)
    vehicle = assets.rendered_vehicle(spec, solution)
    rendered = render_solution(spec, solution, assets)
    theta, code, rendering = rendered.theta, rendered.code, rendered.rendering
    mesh = vehicle_mesh(vehicle, assets.decoder, code.float())
    own_box, own_frame = _mesh_box(mesh, theta), _in_gltf_axes(mesh)
    mesh.vertices = scene_from_object(torch.from_numpy(np.array(mesh.vertices)), theta).numpy()
    kept = slice(None) if rendering.returned is None else rendering.returned.numpy()
    hits, points = rendering.hit_mask.numpy()[kept], rendering.points.numpy()[kept]
    reflectance = _reflectance(scene, rendering, kept)
    boxes = np.concatenate((scene.labels.boxes, own_box[None]))
    classes = [*scene.labels.classes, "vehicle"]
    frame = frame_files(FRAME, points, reflectance, scene.ground_z_m, boxes, classes)
    files = {
        "scene.bin": velodyne_bytes(points, reflectance),
        "scene.ply": _exported(_coloured(points, hits), "ply"),
        "hit_mask.npy": _npy_bytes(hits),
        "object.ply": _exported(mesh, "ply"),
        "object.glb": _exported(own_frame, "glb"),
        "box.json": _box_json(spec, solution, object_box(theta, vehicle.size_m, 0.0), own_box, int(hits.sum())),
        "boxes.json": _boxes_json(boxes, classes, scene.ground_z_m),
        **{f"{_KITTI}/{path}": content for path, content in frame.items()},
    }
    for name, content in files.items():
        write_atomic(folder / name, content)
    return [folder / name for name in files]


def _reflectance(scene: Scene, rendering: Rendering, kept: slice | NDArray[np.bool_]) -> NDArray[np.float32] | None:
    """Return the reflectance of every written point: from effects, else the scene's; 0 for beams without a return."""
    if rendering.reflectance is not None:
        return rendering.reflectance.numpy()[kept].astype(np.float32)
    if scene.reflectance is None:
        return None
    values = np.zeros(len(rendering.points), dtype=np.float32)
    values[: len(scene.reflectance)] = scene.reflectance
    return values[kept]


def _coloured(points: NDArray[np.float32], hits: NDArray[np.bool_]) -> trimesh.PointCloud:
    colours = np.where(hits[:, None], np.array(_OBJECT_RGBA, np.uint8), np.array(_SCENE_RGBA, np.uint8))
    return trimesh.PointCloud(points, colours)


def _in_gltf_axes(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a mesh of the vehicle's own frame with y up and z forward."""
    # A cyclic permutation of the axes is no reflection, so faces keep their orientation.
    return trimesh.Trimesh(np.asarray(mesh.vertices)[:, [1, 2, 0]], mesh.faces, process=False)


def _mesh_box(mesh: trimesh.Trimesh, theta: torch.Tensor) -> NDArray[np.float64]:
    """Return (7,) the object-frame box of a mesh, in the sensor frame: a label, which has no pitch and roll."""
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    centre = scene_from_object(torch.from_numpy((low + high)[None] / 2.0), theta).numpy()[0]
    return np.array([*centre, *(high - low), float(theta[3])])


def _named(box: NDArray[np.float64]) -> dict[str, float]:
    """Return a box's values by name. The heading is wrapped, because a pose's heading is not bounded in a search."""
    x, y, z, dx, dy, dz, heading = map(float, box)
    return dict(zip(_BOX, (x, y, z, dx, dy, dz, math.remainder(heading, 2.0 * math.pi)), strict=True))


def _boxes_json(boxes: NDArray[np.float64], classes: list[str], ground_z_m: float) -> bytes:
    """Write every labelled object and, last, the inserted one."""
    rows = [{"class": kind, "box": _named(box), "inserted": False} for kind, box in zip(classes, boxes, strict=True)]
    rows[-1]["inserted"] = True
    what = {"frame": "lidar", "ground_z_m": float(ground_z_m), "units": _UNITS, "objects": rows}
    return (json.dumps(what, indent=2, sort_keys=True) + "\n").encode()


def _box_json(
    spec: TaskSpec,
    solution: Mapping[str, Any],
    box: NDArray[np.float64],
    own_box: NDArray[np.float64],
    object_points: int,
) -> bytes:
    what = {
        "box": _named(box),
        "own_box": _named(own_box),
        "frame": "lidar",
        "units": _UNITS,
        "class": "vehicle",
        "pose": {name: float(solution[name]) for name in POSE_COLUMNS},
        "object_points": object_points,
        "task_id": spec.task_id,
        "vehicle": spec.vehicle,
        "drawn_as": solution.get("drawn_as"),
        "scene": spec.scene,
        "method": solution["method"],
        "replicate": int(solution["replicate"]),
    }
    return (json.dumps(what, indent=2, sort_keys=True) + "\n").encode()


def _npy_bytes(array: NDArray[np.bool_]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _exported(what: trimesh.Trimesh | trimesh.PointCloud, file_type: str) -> bytes:
    content = what.export(file_type=file_type)
    assert isinstance(content, bytes)
    return content
