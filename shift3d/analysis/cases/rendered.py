"""Solutions rendered again exactly as in the sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import fast_simplification
import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.attack.objective import object_box
from shift3d.detectors.base import Proposals
from shift3d.geometry.se3 import scene_from_object
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.task.assets import Assets, load_assets
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.scoring import boxes_around, detections_near
from shift3d.vehicles.mesh_measures import Measures, measure_mesh
from shift3d.vehicles.vehicle import vehicle_mesh

FloatArray = NDArray[np.float64]
VIEW_M = 10.0  # Half side of the view from above, metres.
_THIN_M, _MOST_POINTS = 0.12, 2500
_FACES = 5000


@dataclass(frozen=True)
class Rendered:
    """Object rendered again, with its detection.

    mesh: object frame, metres. theta: (6,) pose. scene_xy: (P, 2) thinned scene points around the place; object_xy:
    (Q, 2) points of the object; sensor frame, metres. object_points: number of object points. box: (7,) ground truth,
    found: (7,) best box within the detection radius or None; x, y in the sensor frame. score: of that box, 0 without
    one.
    """

    mesh: trimesh.Trimesh
    theta: FloatArray
    scene_xy: FloatArray
    object_xy: FloatArray
    object_points: int
    box: FloatArray
    found: FloatArray | None
    score: float

    @cached_property
    def measures(self) -> Measures:
        """Measures of the mesh."""
        return measure_mesh(self.mesh)


@dataclass
class PageCache:
    """Shared data of one page's objects. Meshes are cached by vehicle, code and resolution: a fine one takes
    seconds."""

    plan: Plan
    _assets: dict[int, Assets] = field(default_factory=dict)
    _meshes: dict[tuple[str, bytes, int], trimesh.Trimesh] = field(default_factory=dict)

    def assets(self, task: PlannedTask) -> Assets:
        """Return the assets of a task. Raises InputError: assets cannot be loaded, or differ from the planned ones."""
        if task.assets not in self._assets:
            self._assets[task.assets] = load_assets(self.plan.assets[task.assets])
        return self._assets[task.assets]

    def mesh(self, task: PlannedTask, solution: Mapping[str, Any], resolution: int = 128) -> trimesh.Trimesh:
        """Return the mesh of a solution, object frame, metres. Raises InputError: the code has no surface."""
        assets, code = self.assets(task), np.array(solution["latent_code"], dtype=np.float32)
        vehicle = assets.rendered_vehicle(task.spec, solution)
        key = (vehicle.name, code.tobytes(), resolution)
        if key not in self._meshes:
            self._meshes[key] = vehicle_mesh(vehicle, assets.decoder, code, resolution)
        return self._meshes[key]


def rerender(task: PlannedTask, solution: Mapping[str, Any], centre_xy: FloatArray, loaded: PageCache) -> Rendered:
    """Render a row of ``solutions.parquet`` as the sweep did, effects included.

    centre_xy: (2,) middle of the view.
    Raises: InputError: assets cannot be loaded or differ from the planned ones, or the code has no surface.
    """
    again = render_solution(task.spec, solution, loaded.assets(task))
    problem, theta, rendering = again.problem, again.theta, again.rendering
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
    proposals = boxes_around(rendering.points, box, problem.ground_z_m, {"it": problem.detector})["it"]
    found, score = best_box(proposals, box, task.spec.attack.detection_radius_m)
    here = np.ones(len(rendering.points), bool) if rendering.returned is None else rendering.returned.numpy()
    points, hits = rendering.points.double().numpy()[:, :2], rendering.hit_mask.numpy()
    return Rendered(
        mesh=loaded.mesh(task, solution),
        theta=theta.numpy(),
        scene_xy=thinned(points[here & ~hits], centre_xy),
        object_xy=points[here & hits],
        object_points=int((here & hits).sum()),
        box=box,
        found=found,
        score=score,
    )


def best_box(proposals: Proposals, box: FloatArray, radius_m: float) -> tuple[FloatArray | None, float]:
    """Return the box (7,) that gives the object at ``box`` its score, and the score; None and 0 without a box."""
    detections = detections_near(proposals, box, radius_m)
    near = np.flatnonzero(np.hypot(*(detections.boxes[:, :2] - box[:2]).T) < radius_m)
    if not len(near):
        return None, 0.0
    return detections.boxes[near[0]], float(detections.scores[near[0]])  # best first


def thinned(points: FloatArray, centre_xy: FloatArray) -> FloatArray:
    """Thin points (N, 2) to the view, at most one per 12 cm cell and 2,500 in all, deterministically."""
    points = points[(np.abs(points - centre_xy) < VIEW_M).all(axis=1)]
    _, kept = np.unique(np.floor(points / _THIN_M).astype(np.int64), axis=0, return_index=True)
    kept = np.sort(kept)
    return points[kept[:: -(-len(kept) // _MOST_POINTS)]] if len(kept) else points


def simplified(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Reduce a mesh to about 5,000 triangles for a page. Returns vertices (V, 3) and triangles (F, 3)."""
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    if len(faces) > _FACES:
        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=_FACES)
    return np.round(vertices, 4).astype(np.float32), np.asarray(faces, np.int32)


def oriented(vertices: NDArray[np.floating[Any]], theta: FloatArray, yaw_rad: float = 0.0) -> FloatArray:
    """Rotate vertices (V, 3) from the object frame to the scene's orientation, around the object's origin.

    theta: (6,) pose. yaw_rad: angle by which the vertices are rotated back.
    """
    pose = torch.from_numpy(np.array(theta, dtype=np.float64))
    pose[:3], pose[3] = 0.0, pose[3] - yaw_rad
    turned = scene_from_object(torch.from_numpy(np.asarray(vertices, dtype=np.float64)), pose)
    return np.asarray(turned.numpy())
