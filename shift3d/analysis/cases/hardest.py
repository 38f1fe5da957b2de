"""Which solutions are shown as hard cases, and each of them rendered again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd
    import trimesh

    from shift3d.detectors.base import Proposals
    from shift3d.task.assets import Assets
    from shift3d.task.spec import TaskSpec

__all__ = ["POSE", "VIEW_M", "Case", "Seen", "hardest", "see", "simplified"]

FloatArray = NDArray[np.float64]
POSE = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
VIEW_M = 10.0
"""Half side of the view from above, metres."""
_THIN_M, _MOST_POINTS = 0.12, 2500
_FACES = 5000


@dataclass(frozen=True)
class Case:
    """A task whose score fell. before, after: scores of the baseline and of what was found."""

    task_id: str
    vehicle: str
    scene: str
    mode: str
    before: float
    after: float

    @property
    def fall(self) -> float:
        """How far the score fell."""
        return self.before - self.after


def hardest(scores: pd.DataFrame, count: int = 4, broken: Collection[str] = ()) -> list[Case]:
    """The tasks whose score fell furthest before the attacked detector, other vehicles and scenes first.

    scores: of ``final/``. Of equal falls the first in the plan's order. broken: tasks whose shape is no car any more;
    they are chosen only where there are not `count` others, and stand last.
    """
    rows = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    first = rows.drop_duplicates("task_id")
    table = rows.pivot_table(index="task_id", columns="method", values="score")
    if not {"baseline", "adversarial"} <= set(table.columns):
        return []
    both = table.dropna(subset=["baseline", "adversarial"])
    cases = [
        Case(row.task_id, row.vehicle, row.scene, row.mode, *map(float, both.loc[row.task_id, _TWO]))
        for row in first.itertuples()
        if row.task_id in both.index
    ]
    left = sorted((case for case in cases if case.fall > 0), key=lambda case: -case.fall)
    chosen: list[Case] = []
    while left and len(chosen) < count:
        # Of those that repeat least, the first is the one that fell furthest.
        best = min(left, key=lambda case: (case.task_id in broken, _repeats(case, chosen)))
        chosen.append(best)
        left.remove(best)
    return sorted(chosen, key=lambda case: (case.task_id in broken, -case.fall))


_TWO = ["baseline", "adversarial"]


def _repeats(case: Case, chosen: list[Case]) -> int:
    vehicles = sum(case.vehicle == other.vehicle for other in chosen)
    return vehicles + sum(case.scene == other.scene for other in chosen)


@dataclass(frozen=True)
class Seen:
    """An object rendered again, and what the detector makes of it.

    mesh: object frame, metres, as measured. theta: (6,) pose. scene_xy: (P, 2) thinned points around the place that
    are not the object's; object_xy: (Q, 2) its own; sensor frame, metres. object_points: before any thinning. box: (7,)
    ground truth, found: (7,) the best box within the detection radius, None without one; x, y of the sensor frame.
    score: of that box, 0 without one.
    """

    mesh: trimesh.Trimesh
    theta: FloatArray
    scene_xy: FloatArray
    object_xy: FloatArray
    object_points: int
    box: FloatArray
    found: FloatArray | None
    score: float


def see(
    spec: TaskSpec,
    assets: Assets,
    solution: Mapping[str, Any],
    centre_xy: FloatArray,
    meshes: dict[tuple[str, bytes], trimesh.Trimesh],
) -> Seen:
    """Render a row of ``solutions.parquet`` as the sweep did, effects included.

    centre_xy: (2,) middle of the view. meshes: those made already, by vehicle and code: a mesh takes seconds.
    Raises: InputError for what cannot be loaded, or is not what was planned with, and for a code without a surface.
    """
    import torch

    from shift3d.attack.objective import SCORE_RADIUS_M, object_box
    from shift3d.attack.problem import measure
    from shift3d.task.run import build_problem
    from shift3d.vehicles.vehicle import vehicle_mesh

    theta = torch.tensor([float(solution[name]) for name in POSE], dtype=torch.float64)
    problem = build_problem(spec, assets, theta)
    code = torch.tensor(np.asarray(solution["latent_code"], dtype=np.float32)).to(problem.settings.dtype)
    with torch.no_grad():
        measured = measure(problem, code, theta, radius_m=SCORE_RADIUS_M)
    rendering = measured.rendering
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
    found, score = _best(measured.proposals, box, spec.attack.detection_radius_m)
    known = (spec.vehicle, code.float().numpy().tobytes())
    if known not in meshes:
        meshes[known] = vehicle_mesh(assets.vehicle(spec), assets.decoder, code.float())
    here = np.ones(len(rendering.points), bool) if rendering.returned is None else rendering.returned.numpy()
    points, hits = rendering.points.double().numpy()[:, :2], rendering.hit_mask.numpy()
    return Seen(
        mesh=meshes[known],
        theta=theta.numpy(),
        scene_xy=_thinned(points[here & ~hits], centre_xy),
        object_xy=points[here & hits],
        object_points=int((here & hits).sum()),
        box=box,
        found=found,
        score=score,
    )


def _best(proposals: Proposals, box: FloatArray, radius_m: float) -> tuple[FloatArray | None, float]:
    """The box (7,) that gives the object at ``box`` its score, and the score; None and 0 without one."""
    from shift3d.detectors.nms import suppress
    from shift3d.task.scoring import SCORE_FLOOR, SUPPRESSION_IOU

    detections = suppress(proposals, SCORE_FLOOR, SUPPRESSION_IOU)
    near = np.flatnonzero(np.hypot(*(detections.boxes[:, :2] - box[:2]).T) < radius_m)
    if not len(near):
        return None, 0.0
    return detections.boxes[near[0]], float(detections.scores[near[0]])  # best first


def _thinned(points: FloatArray, centre_xy: FloatArray) -> FloatArray:
    """Points (N, 2) within the view, at most one a small cell and some thousands in all; the same ones every time."""
    points = points[(np.abs(points - centre_xy) < VIEW_M).all(axis=1)]
    _, kept = np.unique(np.floor(points / _THIN_M).astype(np.int64), axis=0, return_index=True)
    kept = np.sort(kept)
    return points[kept[:: -(-len(kept) // _MOST_POINTS)]] if len(kept) else points


def simplified(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Vertices (V, 3) and triangles (F, 3) of a mesh, few enough for a page; a small mesh as it is."""
    import fast_simplification

    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    if len(faces) > _FACES:
        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=_FACES)
    return np.round(vertices, 4).astype(np.float32), np.asarray(faces, np.int32)
