"""The plan: every task of a sweep, in order, with its id."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shift3d.config import messages
from shift3d.config.catalogue import Catalogue, SceneEntry
from shift3d.config.compose import Composed
from shift3d.config.expand import expand
from shift3d.config.schema import Config, KittiConfig
from shift3d.errors import InputError
from shift3d.store.schemas import SCHEMA_VERSION
from shift3d.sweep.effects import EffectChoices, EffectLine
from shift3d.sweep.tasks import PlannedTask, TaskGroup, Tasks
from shift3d.sweep.tasks_builder import TasksBuilder
from shift3d.task.spec import AssetsSpec, AttackSpec, PlacementSpec, TaskSpec, TransferScene

__all__ = ["Plan", "PlannedTask", "TaskGroup", "Tasks", "make_plan"]


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
    tasks: Tasks
    assets: tuple[AssetsSpec, ...]
    effects: tuple[EffectLine, ...] = ()

    @functools.cached_property
    def spec_hash(self) -> str:
        """64-bit BLAKE2b of the sweep's name and its task ids, hex: what makes two output folders the
        same."""
        state = hashlib.blake2b(json.dumps([SCHEMA_VERSION, self.sweep]).encode()[:-1] + b", [", digest_size=8)
        # The JSON of the list of ids, from their column: ids have one length and nothing to be escaped.
        for start in range(0, len(self.tasks), _HASHED):
            ids = '", "'.join(self.tasks.ids[start : start + _HASHED].to_pylist())
            state.update(f'{", " if start else ""}"{ids}"'.encode())
        state.update(b"]]")
        return state.hexdigest()


_HASHED = 65_536  # ids that are text at a time


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
    builder = TasksBuilder()
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
        builder.add(*_tasks_of(config, catalogue, decided, builder, where), index, config.effects.label)
    tasks = builder.tasks()
    if not tasks or first is None:
        raise InputError("the sweep has no task", where=where, remedy="Give it at least one scene and one vehicle")
    axes = {axis.key: list(axis.texts) for axis in composed.axes}
    plan = Plan(
        composed.name,
        composed.overrides,
        first.settings(),
        axes,
        tasks,
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


def _tasks_of(
    config: Config, catalogue: Catalogue, decided: EffectChoices, builder: TasksBuilder, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Of each task of one combination of settings, a scene each: its ground and its place, as the builder numbers
    them."""
    vehicle = _vehicle_name(config, catalogue, where)
    scenes = [(at, entry) for at, entry in enumerate(catalogue.scenes) if config.scene in (None, entry.name)]
    if not scenes and config.scene is not None:
        raise messages.choice_error("scene", config.scene, [e.name for e in catalogue.scenes], f"{where}, scene")
    if not scenes:
        of = config.scenes.root if isinstance(config.scenes, KittiConfig) else config.scenes.kind
        raise InputError(f"the scene set {of} is empty", where=where, remedy="Check scenes.count and scenes.names")
    effects_of, said = decided.of(config, catalogue, vehicle), config.effects.said()
    transfers = _Transfers(config, catalogue, effects_of, where)
    spec = _spec(config, catalogue, vehicle)
    known: dict[tuple[str, tuple[str, ...], bool], int] = {}
    ground, place = np.empty(len(scenes), dtype=np.int32), np.empty(len(scenes), dtype=np.int32)
    for row, (at, entry) in enumerate(scenes):
        others, effects = transfers.after(at), effects_of(entry)
        key = (entry.dataset, effects, bool(effects) or any(other.effects for other in others))
        if key not in known:
            settings = said if key[2] else {}
            own = replace(spec, dataset=entry.dataset, effects=effects, effect_settings=settings)
            known[key] = builder.ground(own)
        ground[row] = known[key]
        place[row] = builder.place((entry.name, entry.content_hash, others))
    return ground, place


def _spec(config: Config, catalogue: Catalogue, vehicle: str) -> TaskSpec:
    """What the tasks of one combination of settings have in common."""
    attack = config.attack.model_dump(exclude={"alpha", "lambda_", "placement", "transfer_scenes"})
    centre, half_width = catalogue.sector_rad
    placement = PlacementSpec(
        **config.attack.placement.model_dump(), sector_centre_rad=centre, sector_half_width_rad=half_width
    )
    return TaskSpec(
        vehicle=vehicle,
        scene="",
        dataset="",
        mode=config.mode,
        lambda_=float(config.attack.lambda_),
        alpha=float(config.attack.alpha),
        detector=config.detector.name,
        accuracy=config.accuracy.name,
        base_seed=config.seed,
        replicate=config.replicate,
        accuracy_settings=catalogue.accuracy,
        scene_arguments=catalogue.scene_arguments,
        attack=AttackSpec(**attack),
        placement=placement,
        vehicle_hash=catalogue.vehicles[vehicle],
        decoder_hash=catalogue.decoder_hash,
        scored_by=tuple(catalogue.detectors),
        detector_hashes=catalogue.detectors,
    )


class _Transfers:
    """The scenes that shapes are put into: those after a task's own in the set, the first one after the last. Tasks
    that follow each other share all of theirs but one, and a worker has these loaded.

    Raises:
        InputError: more of them are asked for than there are other scenes.
    """

    def __init__(
        self,
        config: Config,
        catalogue: Catalogue,
        effects_of: Callable[[SceneEntry], tuple[str, ...]],
        where: str,
    ) -> None:
        self._count = config.attack.transfer_scenes if config.mode == "shape" else 0
        self._scenes, self._effects_of = catalogue.scenes, effects_of
        if self._count and self._count >= len(self._scenes):
            what = f"attack.transfer_scenes is {self._count}, and the set has {len(self._scenes) - 1} other scenes"
            remedy = f"Give scenes.count={self._count + 1} or more, or fewer of them"
            raise InputError(what, where=where, remedy=remedy)

    def after(self, own: int) -> tuple[TransferScene, ...]:
        """Those of the scene at one position of the set."""
        others = (self._scenes[(own + step) % len(self._scenes)] for step in range(1, self._count + 1))
        return tuple(TransferScene(other.name, other.content_hash, self._effects_of(other)) for other in others)
