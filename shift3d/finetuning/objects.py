"""Objects of a finished sweep: selection of those to fine-tune on, with the attacked detector's scores."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from shift3d.errors import InputError
from shift3d.scenes.sets import independent_group_of
from shift3d.store.location import Location
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import read_final
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.results.final import VERIFICATION
from shift3d.task.assets import Assets, load_assets
from shift3d.task.spec import TaskSpec


@dataclass(frozen=True)
class SweepObject:
    """Row of ``solutions.parquet``. assets: index of its task's assets in the plan. score: of the attacked detector.

    searched: False for the unchanged vehicle that replaces a search without a valid step.
    """

    spec: TaskSpec
    assets: int
    solution: dict[str, Any]
    score: float
    stable: bool | None
    searched: bool = True

    @property
    def key(self) -> tuple[str, str, int]:
        """Task, method and replicate."""
        return self.spec.task_id, self.solution["method"], int(self.solution["replicate"])

    @property
    def place(self) -> str:
        """Street or frame of the object, the unit that intervals resample; see `independent_group_of`."""
        return independent_group_of(self.spec.dataset, self.spec.scene)

    @property
    def settings(self) -> str:
        """Text of the settings that distinguish objects of one vehicle and method, the scene first."""
        spec = self.spec
        effects = "+".join(spec.effects) or "none"
        found = (spec.dataset, spec.scene, spec.mode, spec.lambda_, spec.alpha, spec.search, spec.accuracy, effects,
                 spec.replicate, spec.attack.steps, spec.base_seed)  # fmt: skip
        return " ".join(map(str, (*found, self.solution["replicate"])))


@dataclass
class SweepObjects:
    """Objects of a sweep in plan order. left_out: number of omitted objects by reason."""

    folder: Location
    plan: Plan
    objects: tuple[SweepObject, ...]
    left_out: dict[str, int] = field(default_factory=dict)
    _assets: dict[int, Assets] = field(default_factory=dict)

    def assets_of(self, found: SweepObject) -> Assets:
        """Return the assets of an object's task, loaded on first use. Raises: InputError as `load_assets` does."""
        if found.assets not in self._assets:
            self._assets[found.assets] = load_assets(self.plan.assets[found.assets])
        return self._assets[found.assets]

    @property
    def by_scene(self) -> dict[str, SweepObject]:
        """One object per scene, by scene name; further scenes of the same name add their content hash."""
        found: dict[str, SweepObject] = {}
        for row in self.objects:
            first = found.setdefault(row.spec.scene, row)
            if first.spec.scene_hash != row.spec.scene_hash:
                found.setdefault(f"{row.spec.scene}-{row.spec.scene_hash}", row)
        return found

    @property
    def scenes(self) -> list[tuple[str, str, str]]:
        """Data set, name and content hash of each scene."""
        return list(dict.fromkeys((row.spec.dataset, row.spec.scene, row.spec.scene_hash) for row in self.objects))


def scored_objects(folder: LocationLike, detector: str, methods: tuple[str, ...]) -> SweepObjects:
    """Return every object of some methods that the attacked detector scored.

    Raises: InputError: no finished sweep, or a damaged one; another detector was attacked; nothing was scored.
    """
    folder = as_location(folder)
    plan = read_plan(folder)
    rows = [row for row in read_final(folder, "scores").to_pylist() if row["method"] in methods]
    own = [row for row in rows if row["scored_by"] == row["detector"]]
    scores = {_key(row): row for row in own if row["score"] is not None}
    solutions: dict[str, list[dict[str, Any]]] = {}
    for row in read_final(folder, "solutions").to_pylist():
        if _key(row) in scores:
            solutions.setdefault(row["task_id"], []).append(row)
    found = []
    for task in plan.tasks:
        for solution in solutions.get(task.spec.task_id, ()):
            row = scores[_key(solution)]
            searched = row["method"] != "adversarial" or row["status"] != "no_valid_step"
            found.append(SweepObject(task.spec, task.assets, solution, row["score"], row["stable"], searched))
    attacked = sorted({task.spec.detector for task in plan.tasks})
    if attacked != [detector]:
        what = f"attacked {', '.join(attacked)}, not {detector}"
        raise InputError(what, where=str(folder), remedy=f"Give the folder of a sweep with detector={detector}")
    if not found:
        what = f"no task has a scored {' or '.join(methods)} object"
        raise InputError(what, where=str(folder), remedy="See status in final/scores.parquet")
    left_out = Counter(row["status"] for row in own if row["score"] is None)
    return SweepObjects(folder, plan, tuple(found), dict(left_out))


def _key(row: Mapping[str, Any]) -> tuple[str, str, int]:
    return row["task_id"], row["method"], row["replicate"]


def refuse_other_weights(found: SweepObjects, weights_hash: str, whose: str, remedy: str) -> None:
    """Refuse a sweep that attacked weights of another hash. whose: names the expected weights. Raises: InputError."""
    detector = found.objects[0].spec.detector
    if any(row.spec.detector_hashes.get(detector) != weights_hash for row in found.objects):
        raise InputError(f"attacked other weights of {detector} than {whose}", str(found.folder), remedy)


def refuse_other_splits(specs: Iterable[TaskSpec], where: str) -> None:
    """Refuse tuning tasks on streets of another split than train. Raises: InputError naming a street."""
    for spec in specs:
        made = spec.scene_arguments
        if made.get("kind") == "street" and made.get("split") != "train":
            what = f"contains {spec.scene}, a street of split {made.get('split')}, not train"
            raise InputError(what, where=where, remedy="Run the sweep with scenes.split=train")


def stable_objects(folder: LocationLike, detector: str, weights_hash: str, method: str) -> SweepObjects:
    """Return a method's objects to fine-tune on, of tasks whose adversarial object is still hard at reference accuracy.

    A control, which is tuned on the unchanged vehicles, thus sees the same scenes equally often.
    weights_hash: of the weights that the tuning starts from, `settings.catalogue.detector_files.detector_hash`. method:
    "adversarial", or "baseline" for the unchanged vehicles.
    Tasks whose verification was quarantined are left out: verifying again does not run them.
    Raises: InputError: as `scored_objects`; the sweep is not verified, has no stable object, attacked other weights, or
    ran on streets of another split than train.
    """
    found = scored_objects(folder, detector, ("adversarial",))
    where = str(found.folder)
    failed = {task for entry in read_log(found.folder / VERIFICATION) for task in entry.quarantined}
    if {row.spec.task_id for row in found.objects if row.stable is None} - failed:
        remedy = f"Verify the sweep first: shift3d verify {shlex.quote(where)}"
        raise InputError("is not verified, so its stable objects are unknown", where=where, remedy=remedy)
    refuse_other_weights(
        found, weights_hash, "the tuning starts from", "Give start_from= the weights that the sweep attacked"
    )
    refuse_other_splits((row.spec for row in found.objects), where)
    searched = [row for row in found.objects if row.searched]
    stable = tuple(row for row in searched if row.stable)
    if not stable:
        raise InputError("no adversarial object is stable", where=where, remedy="See final/stability.html")
    left_out = Counter(found.left_out)
    unverified = sum(row.stable is None for row in searched)
    unstable = len(searched) - len(stable) - unverified
    left_out.update(no_valid_step=len(found.objects) - len(searched), unverified=unverified, unstable=unstable)
    if method != "adversarial":
        tasks = {row.spec.task_id for row in stable}
        stable = tuple(row for row in scored_objects(folder, detector, (method,)).objects if row.spec.task_id in tasks)
    return SweepObjects(found.folder, found.plan, stable, {why: number for why, number in left_out.items() if number})
