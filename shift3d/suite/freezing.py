"""Freezing of a finished sweep's solutions: each is rendered and scored again, and stored with its scene."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

import shift3d
from shift3d.attack.objective import object_box
from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.scenes.sets import independent_group_of
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.suite.frozen import BOX, FrozenSuite, background_file, blake2b, manifest_bytes, read_manifest, read_suite
from shift3d.suite.selection import Selection, SelectionRule, select_solutions
from shift3d.suite.tables import SUITE_VERSION, read_suite_table, suite_table, suite_table_bytes
from shift3d.suite.writer import SCENE_PREFIX, Frames, SuiteWriter
from shift3d.sweep.planning.folder import read_plan
from shift3d.task.assets import Assets, load_assets, score_precision
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.follow_ups.verify import SCORE_TOLERANCE
from shift3d.task.scoring import score_box

if TYPE_CHECKING:
    import pandas as pd

    from shift3d.scenes.scene import Scene
    from shift3d.sweep.planning.plan import Plan
    from shift3d.sweep.planning.tasks import PlannedTask
    from shift3d.task.spec import TaskSpec

_UNFINISHED = {"objects.parquet", "scores.parquet", "backgrounds"}  # other files that a killed freezing leaves
_LEFT_OUT = "left_out"  # role in temporary files of an object whose score differs from the sweep's


@dataclass(frozen=True)
class FreezeResult:
    """Result of a freezing. left_out: number of solutions by reason. unverified: number of hard objects never verified.
    largest_difference: between a score of the sweep and the frozen object's; None: no object was scored again."""

    suite: FrozenSuite
    left_out: Mapping[str, int]
    unverified: int
    largest_difference: float | None


def freeze_suite(
    sweep: LocationLike, to: LocationLike, choice: SelectionRule, frames: Frames = "copied"
) -> FreezeResult:
    """Freeze hard objects of a finished sweep, and their controls, into a folder or bucket.

    The same sweep and choice give the same bytes, even if killed and resumed. ``suite.json`` is written last: without
    it the same call resumes scene by scene, with it nothing is written.
    frames: "copied" stores the scenes' points. "referenced" stores their origin, and of recorded frames only the points
    that an object moved: the gate then needs the data set, or generates the streets again.
    Raises: InputError as `select_solutions`; other content in `to`; a scene, vehicle or detector not the sweep's.
    Source: our choice: the paper has no gate.
    """
    sweep, to = as_location(sweep), as_location(to)
    plan = read_plan(sweep)
    chosen = select_solutions(sweep, choice)
    scores = blake2b((sweep / "final" / "scores.parquet").read_bytes())
    made = {"sweep": plan.sweep, "spec_hash": plan.spec_hash, "scores": scores, **asdict(choice)}
    if (to / "suite.json").is_file():
        manifest = read_manifest(to / "suite.json")
        if (manifest.get("made"), manifest.get("frames")) != (made, frames):
            raise InputError("holds another suite", str(to), "Give another to=DIR")
        _forget_scenes(to)
        return FreezeResult(read_suite(to), chosen.left_out, chosen.unverified, None)
    if any(name not in _UNFINISHED and not name.startswith(SCENE_PREFIX) for name in to.names()):
        raise InputError("is not a suite, and is not empty", str(to), "Give another to=DIR")
    to.check_writable("to=DIR")
    writing = SuiteWriter(to, frames, blake2b(json.dumps([made, frames], sort_keys=True).encode()))
    objects, left_out, largest = _objects(plan, chosen, writing)
    if all(row["role"] == "control" for row in objects):
        raise InputError("no object has the score that the sweep reports", str(sweep), "Run the sweep again")
    writing.write("objects.parquet", suite_table_bytes(suite_table("objects", objects)))
    writing.write("scores.parquet", suite_table_bytes(_sweep_scores(plan, chosen.scores, objects)))
    manifest = _manifest(plan, made, objects, writing)
    (to / "suite.json").write_atomic(manifest_bytes(manifest))
    _forget_scenes(to)
    return FreezeResult(read_suite(to), chosen.left_out | left_out, chosen.unverified, largest)


def _forget_scenes(to: Location) -> None:
    for name in to.names():
        if name.startswith(SCENE_PREFIX):
            (to / name).delete()


def number_of_scenes(objects: Iterable[Mapping[str, Any]]) -> int:
    """Count the independent scenes of objects, as a gate does: a street seen by two sensors counts once."""
    return len({independent_group_of(row["dataset"], row["scene"]) for row in objects})


def _manifest(
    plan: Plan, made: Mapping[str, Any], objects: list[dict[str, Any]], writing: SuiteWriter
) -> dict[str, Any]:
    return {
        "version": SUITE_VERSION,
        "shift3d": shift3d.__version__,
        "made": dict(made),
        "frames": writing.frames,
        "scene_sets": writing.sets,
        "datasets": sorted({row["dataset"] for row in objects}),
        "vehicles": sorted({row["vehicle"] for row in objects}),
        "attacked": sorted({template.detector for template in plan.tasks.templates}),
        **{f"{role}_objects": sum(row["role"] == role for row in objects) for role in ("hard", "control")},
        "scenes": number_of_scenes(objects),
        "files": dict(sorted(writing.digests.items())),
    }


def _objects(
    plan: Plan, chosen: Selection, writing: SuiteWriter
) -> tuple[list[dict[str, Any]], dict[str, int], float | None]:
    """Return rows of ``objects.parquet``, scene by scene, a control before its hard objects; the number left out by
    reason; the largest difference of scores, None if every scene was read from its temporary file."""
    known = chosen.scores[chosen.scores["scored_by"] == chosen.scores["detector"]]
    keys = zip(known["task_id"], known["method"], known["replicate"], strict=True)
    freezing = _SceneFreezer(plan, writing, dict(zip(keys, known["score"], strict=True)), chosen.controls)
    objects: dict[str, dict[str, Any]] = {}
    left_out: Counter[str] = Counter()
    scenes = chosen.hard.groupby(["dataset", "scene"], sort=True)  # so that each scene is loaded once
    with progress_bar(total=len(chosen.hard), desc="freezing", unit="object") as progress:
        for (dataset, scene), hard in scenes:
            for row in freezing.scene(f"{dataset}/{scene}", hard):
                if row["role"] == _LEFT_OUT:
                    left_out["with a score other than the sweep's"] += 1
                else:
                    objects.setdefault(row["object_id"], row)
            progress.update(len(hard))
    return list(objects.values()), dict(left_out), freezing.largest


@dataclass
class _SceneFreezer:
    """Freezing, scene by scene. reported: scores by task, method and replicate. largest: difference from these. held:
    assets by index in the plan. seen: rows and scores of controls, which several tasks of a scene share."""

    plan: Plan
    writing: SuiteWriter
    reported: Mapping[tuple[str, str, int], float]
    controls: pd.DataFrame
    largest: float | None = None
    held: dict[int, Assets] = field(default_factory=dict)
    seen: dict[tuple[object, ...], tuple[dict[str, Any], float]] = field(default_factory=dict)

    def scene(self, name: str, hard: pd.DataFrame) -> list[dict[str, Any]]:
        """Return the rows of one scene's objects, from its temporary file if there is one; else write that file."""
        file = self.writing.scene_file(name)
        rows: list[dict[str, Any]] = read_suite_table(file, "objects").to_pylist() if file.is_file() else []
        if rows and all(self._register(row) for row in rows):
            return rows
        rows = [row for solution in hard.to_dict("records") for row in self._pair(solution)]
        file.write_atomic(suite_table_bytes(suite_table("objects", rows)))
        return rows

    def _register(self, row: Mapping[str, Any]) -> bool:
        """Register a stored row's scene set and background. Returns True if the background is in the suite."""
        (task,) = self.plan.tasks.starting_with(row["task_id"])
        self.writing.scene_set(self.plan.assets[task.assets].scenes)
        if self.writing.frames == "copied":
            name = background_file(row["background"])
            if not (self.writing.to / name).is_file():
                return False
            self.writing.digests[name] = blake2b((self.writing.to / name).read_bytes())
        return True

    def _pair(self, hard: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the rows of a solution's control and of the solution."""
        (task,) = self.plan.tasks.starting_with(hard["task_id"])
        if task.assets not in self.held:
            self.held[task.assets] = load_assets(self.plan.assets[task.assets])
        number, control = self.writing.scene_set(self.plan.assets[task.assets].scenes), None
        controls = self.controls[self.controls["task_id"] == hard["task_id"]].to_dict("records")
        rows = []
        for role, solution in (*(("control", row) for row in controls), ("hard", hard)):
            row, score = self._object(task, solution, role == "control")
            off = abs(score - self.reported[solution["task_id"], solution["method"], solution["replicate"]])
            same = off <= SCORE_TOLERANCE
            rows.append({**row, "role": role if same else _LEFT_OUT, "control": control, "frames": number})
            if same:
                self.largest, control = max(self.largest or 0.0, off), row["object_id"]
        return rows

    def _object(self, task: PlannedTask, solution: Mapping[str, Any], shared: bool) -> tuple[dict[str, Any], float]:
        """Call `_object`. shared: reuse the row of another task whose baseline is equal bit for bit."""
        if not shared:
            return _object(task.spec, solution, self.held[task.assets], self.writing)
        shape, pose = np.asarray(solution["latent_code"]).tobytes(), tuple(solution[name] for name in POSE_COLUMNS)
        key = (task.assets, task.spec.baseline.task_id, shape, pose)
        if key not in self.seen:
            self.seen[key] = _object(task.spec, solution, self.held[task.assets], self.writing)
        row, score = self.seen[key]
        return row | {"task_id": task.spec.task_id, "mode": task.spec.mode}, score


def _object(
    spec: TaskSpec, solution: Mapping[str, Any], assets: Assets, writing: SuiteWriter
) -> tuple[dict[str, Any], float]:
    """Return a solution's row without its role, and the attacked detector's score."""
    found = render_solution(spec, solution, assets)
    problem, theta, rendering, scene = found.problem, found.theta, found.rendering, assets.scene(spec)[0]
    box, radius_m = object_box(theta, problem.vehicle.size_m, problem.ground_z_m), spec.attack.detection_radius_m
    detectors = {spec.detector: problem.detector}
    score = score_box(rendering.points, box, problem.ground_z_m, radius_m, detectors)[spec.detector].score
    rows, new = _changes(scene, rendering.points.numpy())
    hits = np.flatnonzero(rendering.hit_mask.numpy()).astype(np.int32)
    background, place = writing.background(scene.points), object_box(theta, problem.vehicle.size_m, 0.0)
    parts = (background.encode(), rows.tobytes(), new.tobytes(), box.tobytes(), np.float64(radius_m).tobytes())
    row = {
        "object_id": blake2b(b"".join(parts)),
        "task_id": spec.task_id,
        "vehicle": assets.rendered_vehicle(spec, solution).name,
        **{name: getattr(spec, name) for name in ("scene", "dataset", "mode")},
        **{name: solution[name] for name in ("method", "replicate", "pitch_rad", "roll_rad")},
        "background": background,
        "scene_hash": scene.content_hash(),
        "effects": list(spec.effects),
        "ground_z_m": float(problem.ground_z_m),
        **dict(zip(BOX, place.tolist(), strict=True)),
        "radius_m": float(radius_m),
        "precision": score_precision(spec),
        "object_points": len(hits),
        "latent_code": np.asarray(solution["latent_code"], dtype=np.float32),
        "rows": rows,
        "points": new.ravel(),
        "hits": hits,
    }
    return row, score


def _changes(scene: Scene, points: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return rows (K,) of scene points that differ bit for bit; new points (K + more, 3): changed, then appended."""
    count = len(scene.points)
    now, before = (np.ascontiguousarray(part).view(np.int32) for part in (points[:count], scene.points))
    rows = np.flatnonzero((now != before).any(axis=1)).astype(np.int32)
    return rows, np.concatenate((points[rows], points[count:])).astype(np.float32)


def _sweep_scores(plan: Plan, scores: pd.DataFrame, objects: list[dict[str, Any]]) -> pa.Table:
    """Return every sweep detector's scores of the objects: the release that the first gate compares with."""
    ids = dict.fromkeys(row["task_id"] for row in objects)
    weights = {name: plan.tasks.starting_with(name)[0].spec.detector_hashes for name in ids}
    by_key = dict(iter(scores.groupby(["task_id", "method", "replicate"])))
    rows = [
        {
            "object_id": row["object_id"],
            "detector": name,
            "weights": weights[row["task_id"]].get(name, ""),
            "score": score,
        }
        for row in objects
        for name, score in by_key[row["task_id"], row["method"], row["replicate"]][["scored_by", "score"]].values
    ]
    return suite_table("scores", rows)
