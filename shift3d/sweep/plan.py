"""The plan: every task of a sweep, in order, with its id."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from shift3d.config import messages
from shift3d.config.catalogue import Catalogue, SceneEntry
from shift3d.config.compose import Composed
from shift3d.config.expand import expand
from shift3d.config.schema import Config, KittiConfig
from shift3d.errors import InputError
from shift3d.store.schemas import SCHEMA_VERSION
from shift3d.sweep.effects import EffectChoices, EffectLine
from shift3d.task.spec import AssetsSpec, AttackSpec, PlacementSpec, TaskSpec, TransferScene

__all__ = ["Plan", "PlannedTask", "make_plan"]


@dataclass(frozen=True)
class PlannedTask:
    """A task and what its worker needs loaded (an index into ``Plan.assets``).

    effects_asked: the settings of effects that lead to this task, one or more: "auto", "none", or names joined by +.
    """

    spec: TaskSpec
    assets: int
    effects_asked: tuple[str, ...] = ("none",)

    def also(self, asked: str) -> PlannedTask:
        """The same task, asked for under one more setting of effects."""
        return self if asked in self.effects_asked else replace(self, effects_asked=(*self.effects_asked, asked))


@dataclass(frozen=True)
class Plan:
    """A sweep's tasks in order, without duplicates.

    settings: of the first task, for the reader. axes: key to values as they were written.
    effects: what was decided about each effect for each scene, see `sweep.effects`.
    runner, tracking: how it runs; they are no part of the hash.
    """

    sweep: str
    overrides: tuple[str, ...]
    settings: dict[str, Any]
    axes: dict[str, list[str]]
    tasks: tuple[PlannedTask, ...]
    assets: tuple[AssetsSpec, ...]
    effects: tuple[EffectLine, ...] = ()

    @property
    def spec_hash(self) -> str:
        """64-bit BLAKE2b of the sweep's name and its task ids, hex: what makes two output folders the
        same."""
        what = [SCHEMA_VERSION, self.sweep, [task.spec.task_id for task in self.tasks]]
        return hashlib.blake2b(json.dumps(what).encode(), digest_size=8).hexdigest()


def make_plan(composed: Composed, catalogue_of: Callable[[Config], Catalogue]) -> tuple[Plan, Config]:
    """Expand a sweep into its tasks.

    Combinations that ask for the same task (a pose attack under several lambda) give one task, at its first
    place in the order. Scenes vary fastest.

    Returns:
        the plan, and the settings of its first task (for ``runner`` and ``tracking``).

    Raises:
        InputError: unknown names, unreadable scenes or weights, or an empty sweep.
    """
    where = f"sweep {composed.name}"
    catalogues: dict[str, tuple[Catalogue, int]] = {}
    assets: list[AssetsSpec] = []
    tasks: dict[str, PlannedTask] = {}
    first: Config | None = None
    decided = EffectChoices()
    for config in expand(composed):
        first = first or config
        key = _assets_key(config)
        if key not in catalogues:
            catalogue = catalogue_of(config)
            loaded = _assets(config, catalogue)
            if loaded not in assets:
                assets.append(loaded)
            catalogues[key] = (catalogue, assets.index(loaded))
        catalogue, index = catalogues[key]
        for spec in _specs(config, catalogue, decided, where):
            asked = config.effects.label
            tasks[spec.task_id] = tasks.get(spec.task_id, PlannedTask(spec, index, (asked,))).also(asked)
    if not tasks or first is None:
        raise InputError("the sweep has no task", where=where, remedy="Give it at least one scene and one vehicle")
    axes = {axis.key: list(axis.texts) for axis in composed.axes}
    plan = Plan(
        composed.name,
        composed.overrides,
        first.settings(),
        axes,
        tuple(tasks.values()),
        tuple(assets),
        decided.lines(),
    )
    return plan, first


def _assets_key(config: Config) -> str:
    parts = (config.scenes, config.detector, config.accuracy)
    return json.dumps([part.model_dump(mode="json") for part in parts] + [_vehicles(config)])


def _vehicles(config: Config) -> dict[str, Any]:
    return config.vehicle.model_dump(mode="json", exclude={"name"})


def _assets(config: Config, catalogue: Catalogue) -> AssetsSpec:
    given = config.detector.weights_by_name()
    return AssetsSpec(
        scenes=config.scenes.model_dump(mode="json"),
        vehicles=_vehicles(config),
        detectors={name: given.get(name) for name in catalogue.detectors},
        hashes={"decoder": catalogue.decoder_hash, **catalogue.detectors},
    )


def _vehicle_name(config: Config, catalogue: Catalogue, where: str) -> str:
    """A vehicle by its name, or by a beginning of it that is no other's."""
    name, names, where = config.vehicle.name, list(catalogue.vehicles), f"{where}, vehicle.name"
    fitting = [found for found in names if found.startswith(name)]
    if name in names or len(fitting) == 1:
        return name if name in names else fitting[0]
    if fitting:
        what = f"{len(fitting)} vehicles have a name that begins with {name!r}"
        raise InputError(what, where=where, remedy=f"One of: {', '.join(fitting)}")
    raise messages.choice_error("vehicle", name, names, where)


def _specs(config: Config, catalogue: Catalogue, decided: EffectChoices, where: str) -> list[TaskSpec]:
    vehicle = _vehicle_name(config, catalogue, where)
    vehicle_hash = catalogue.vehicles[vehicle]
    scenes = [entry for entry in catalogue.scenes if config.scene in (None, entry.name)]
    if not scenes and config.scene is not None:
        raise messages.choice_error("scene", config.scene, [e.name for e in catalogue.scenes], f"{where}, scene")
    if not scenes:
        of = config.scenes.root if isinstance(config.scenes, KittiConfig) else config.scenes.kind
        raise InputError(f"the scene set {of} is empty", where=where, remedy="Check scenes.count and scenes.names")
    effects_of, said = decided.of(config, catalogue, vehicle), config.effects.said()
    attack = config.attack.model_dump(exclude={"alpha", "lambda_", "placement", "transfer_scenes"})
    centre, half_width = catalogue.sector_rad
    placement = PlacementSpec(
        **config.attack.placement.model_dump(), sector_centre_rad=centre, sector_half_width_rad=half_width
    )
    elsewhere = {entry.name: _transfer_scenes(config, catalogue, entry, effects_of, where) for entry in scenes}
    return [
        TaskSpec(
            vehicle=vehicle,
            scene=entry.name,
            dataset=entry.dataset,
            mode=config.mode,
            lambda_=float(config.attack.lambda_),
            alpha=float(config.attack.alpha),
            detector=config.detector.name,
            accuracy=config.accuracy.name,
            base_seed=config.seed,
            replicate=config.replicate,
            effects=(effects := effects_of(entry)),
            effect_settings=said if effects or any(other.effects for other in elsewhere[entry.name]) else {},
            accuracy_settings=catalogue.accuracy,
            scene_arguments=catalogue.scene_arguments,
            attack=AttackSpec(**attack),
            placement=placement,
            scene_hash=entry.content_hash,
            vehicle_hash=vehicle_hash,
            decoder_hash=catalogue.decoder_hash,
            scored_by=tuple(catalogue.detectors),
            detector_hashes=catalogue.detectors,
            transfer_scenes=elsewhere[entry.name],
        )
        for entry in scenes
    ]


def _transfer_scenes(
    config: Config,
    catalogue: Catalogue,
    entry: SceneEntry,
    effects_of: Callable[[SceneEntry], tuple[str, ...]],
    where: str,
) -> tuple[TransferScene, ...]:
    """The scenes after a task's own in the set, the first one after the last: tasks that follow each other share all of
    theirs but one, and a worker has these loaded."""
    count, scenes = config.attack.transfer_scenes, catalogue.scenes
    if config.mode != "shape" or not count:
        return ()
    if count >= len(scenes):
        what = f"attack.transfer_scenes is {count}, and the set has {len(scenes) - 1} other scenes"
        raise InputError(what, where=where, remedy=f"Give scenes.count={count + 1} or more, or fewer of them")
    own = scenes.index(entry)
    others = [scenes[(own + step) % len(scenes)] for step in range(1, count + 1)]
    return tuple(TransferScene(other.name, other.content_hash, effects_of(other)) for other in others)
