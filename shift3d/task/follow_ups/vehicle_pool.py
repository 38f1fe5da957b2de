"""Vehicle pool of one scene: its labelled vehicles are cropped, fitted, and scored by the detector at their places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.attack.objective import SCORE_RADIUS_M, to_network_frame
from shift3d.detectors.base import Detector, Proposals
from shift3d.errors import InputError
from shift3d.geometry.iou import iou_bev
from shift3d.retrieval.crops import Crop, crop_vehicles
from shift3d.retrieval.reconstruction import Reconstructor
from shift3d.retrieval.subspace import Subspace
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.sdf.meshes import symmetric_chamfer
from shift3d.seeding import generator
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.scoring import detections_until, timed
from shift3d.task.spec import TaskSpec

if TYPE_CHECKING:
    from shift3d.vehicles.sources import VehicleSource

OWN_IOU = 0.3
"""Least bird's-eye IoU of a box with a label to count as its detection: cars park nearer than 5 m."""
_AT_CENTRE_M = 0.01
_VEHICLES, _COMPARED = 5, 1000
_BOX = ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw_rad")


@dataclass(frozen=True)
class PoolAssets:
    """Assets of a worker: scenes and detectors, and the reconstructor of shapes."""

    assets: Assets
    reconstructor: Reconstructor


def load_pool_assets(spec: AssetsSpec) -> PoolAssets:
    """Load what the scenes of a pool share. Raises: InputError as `load_assets`."""
    assets = load_assets(spec)
    return PoolAssets(assets, reconstructor_of(assets.vehicles))


def reconstructor_of(vehicles: VehicleSource) -> Reconstructor:
    """Build the shape reconstructor of a set: principal components of its codes, scale of its first vehicles.

    Raises: InputError for fewer codes than components need.
    """
    known = [vehicles.vehicle(name) for name in vehicles.names()[:_VEHICLES]]
    per_length = float(np.mean([vehicle.scale_m / vehicle.size_m[0] for vehicle in known]))
    return Reconstructor(Subspace.of(vehicles.decoder(), vehicles.codes()), per_length, known[0].sdf_R_object)


def pool_task(spec: TaskSpec, held: PoolAssets) -> TaskResult:
    """Crop and fit every labelled vehicle of the task's scene: one row each; refused vehicles have the reason.

    A vehicle beyond the detector's grid is refused as well ("beyond_grid"): its score in the scene is unknown.

    The result is a pure function of the spec's scene and the content that its hashes name, on one thread.
    Raises: InputError: a scene that cannot be loaded, or that differs from the plan.
    Source: SHIFT3D, supplement, 'Retrieving the Nearest Match'.
    """
    scene, _ = held.assets.scene(spec)
    spent: dict[str, float] = {}
    with timed(spent, "crop"):
        crops = crop_vehicles(scene)
    with timed(spent, "detector"):
        scores = _scores(spec, held.assets, scene, crops)
    crops = [crop if crop.label in scores else replace(crop, refused="beyond_grid") for crop in crops]
    with timed(spent, "fit"):
        truth = _true_meshes(held.assets, spec.scene, crops)
        known = [{"score": scores.get(crop.label, 0.0), "detector": spec.detector} for crop in crops]
        rows = [_row(held.reconstructor, crop, truth.get(crop.label)) | more for crop, more in zip(crops, known)]
    timings: list[Row] = [
        {"method": "pool", "stage": stage, "milliseconds": milliseconds, "calls": len(crops)}
        for stage, milliseconds in spent.items()
    ]
    return TaskResult(timings=timings, vehicle_pool=rows)


def _row(reconstructor: Reconstructor, crop: Crop, truth: trimesh.Trimesh | None) -> Row:
    row: Row = {
        "label": crop.label,
        "kind": crop.kind,
        **dict(zip(_BOX, map(float, crop.box), strict=True)),
        "range_m": crop.range_m,
        "points": crop.points,
        "sides": list(crop.sides),
        "status": crop.refused or "fitted",
        "flags": [],
    }
    if crop.refused:
        return row
    found = reconstructor.reconstruct(crop)
    row |= {
        "flags": list(found.flags),
        "latent_code": reconstructor.subspace.code(found.fit.u).tolist(),
        "scale_m": found.fit.scale_m,
        "coordinates": found.fit.u.tolist(),
        "uncertainty": found.fit.uncertainty.tolist(),
        "residual_cm": 100.0 * found.fit.residual_m,
        "outliers": found.fit.outliers,
    }
    if truth is not None and "no_surface" not in found.flags:
        mean = reconstructor.mean_mesh(float(crop.box[3]))
        row["shape_error_cm"] = _apart_cm(reconstructor.mesh(found.fit), truth)
        row["mean_shape_error_cm"] = _apart_cm(mean, truth)
    return row


def _apart_cm(mesh: trimesh.Trimesh, truth: trimesh.Trimesh) -> float:
    return 100.0 * symmetric_chamfer(mesh, truth, generator("shape error"), _COMPARED)


def _true_meshes(assets: Assets, name: str, crops: list[Crop]) -> Mapping[int, trimesh.Trimesh]:
    """Return the true meshes of a street's labels, object frame, by label; none for recorded scenes."""
    if not isinstance(assets.scenes, StreetScenes):
        return {}
    placed = assets.scenes.vehicles(name)
    found = {}
    for crop in crops:
        near = min(placed, key=lambda other: float(np.linalg.norm(other.position - crop.box[:3])))
        mesh = near.vehicle.intersector
        found[crop.label] = trimesh.Trimesh(mesh.vertices.astype(np.float64), mesh.faces, process=False)
    return found


def _scores(spec: TaskSpec, assets: Assets, scene: Scene, crops: list[Crop]) -> dict[int, float]:
    """Return, by label, the best score of a box that overlaps the vehicle at its place; 0 without such a box.

    Vehicles beyond the detector's grid are left out.
    """
    detector = assets.detector_of(spec.detector, "float32")
    crops = [crop for crop in crops if _in_grid(detector, crop.box)]
    if not crops:
        return {}
    boxes = np.stack([crop.box for crop in crops])
    boxes[:, 2] -= scene.ground_z_m
    middle = (boxes[:, :2].min(axis=0) + boxes[:, :2].max(axis=0)) / 2
    reach = float(np.linalg.norm(boxes[:, :2] - middle, axis=1).max()) + SCORE_RADIUS_M
    window = detector.window_for((float(middle[0]), float(middle[1])), reach)
    points = to_network_frame(torch.from_numpy(scene.points[scene.has_beam]), scene.ground_z_m)
    with torch.no_grad():
        proposals = detector.proposals(points, window)
    return {crop.label: overlap_score(proposals, box) for crop, box in zip(crops, boxes)}


def _in_grid(detector: Detector, box: NDArray[np.float64]) -> bool:
    """True if the detector has a cell at the centre of box (7,). Detectors without a grid see every place."""
    try:
        detector.window_for((float(box[0]), float(box[1])), _AT_CENTRE_M)
    except InputError:
        return False
    return True


def overlap_score(proposals: Proposals, box: NDArray[np.float64]) -> float:
    """Return the score of the best box after suppression that overlaps box (7,), network frame; 0 without one."""
    own = iou_bev(box, proposals.boxes.numpy())[0] >= OWN_IOU
    found = detections_until(proposals, box, own)
    return float((found.scores * (iou_bev(box, found.boxes)[0] >= OWN_IOU)).max(initial=0.0))
