"""Plan of a sweep: all its tasks, in order, with their ids."""

from __future__ import annotations

import copy
import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from shift3d.detectors.names import FOREIGN, ONNX, OWN
from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.settings import messages
from shift3d.settings.catalogue.detector_files import detector_layouts, require_in_grid, require_used
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.compose import ComposedSweep
from shift3d.settings.expand import expand
from shift3d.settings.schema.config import Config, DetectorConfig
from shift3d.sweep.planning.effect_choices import Decision, EffectChoiceCache
from shift3d.sweep.planning.layout import LayoutCache
from shift3d.sweep.planning.tasks import Tasks
from shift3d.sweep.planning.tasks_builder import TasksBuilder
from shift3d.task.exchange import AssetsSpec
from shift3d.task.spec import BUDGET_RULE, AttackSpec, PlacementSpec, TaskSpec
from shift3d.vehicles.parameter_box import kind_and_number

# First value of a sweep's hash. It never changes, so that a folder of an older program stays the same sweep.
_IDENTITY = 5


@dataclass(frozen=True)
class Plan:
    """Tasks of a sweep in order, without duplicates.

    settings: of the first task, for the reader. axes: key to values as they were written. effects: decision about each
    effect for each scene. skipped: unreadable scenes that are left out, name to reason. notes: lines for the reader,
    without effect on results. preview: the content of some scenes is unknown, so ids differ from those of the sweep.
    """

    sweep: str
    overrides: tuple[str, ...]
    settings: dict[str, Any]
    axes: dict[str, list[str]]
    tasks: Tasks
    assets: tuple[AssetsSpec, ...]
    effects: tuple[Decision, ...] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)
    preview: bool = False
    notes: tuple[str, ...] = ()

    @property
    def common_settings(self) -> dict[str, Any]:
        """Settings of every task: those that are no axis."""
        common = copy.deepcopy(self.settings)
        for key in self.axes:
            *parents, leaf = key.split(".")
            functools.reduce(lambda part, name: part.get(name) or {}, parents, common).pop(leaf, None)
        return common

    @functools.cached_property
    def spec_hash(self) -> str:
        """Hash of the sweep's name and its task ids (64-bit BLAKE2b, hex), which identifies an output folder. Raises
        ValueError for a preview, which has no hash yet."""
        if self.preview:
            raise ValueError("a preview has no hash")
        state = hashlib.blake2b(json.dumps([_IDENTITY, self.sweep]).encode()[:-1] + b", [", digest_size=8)
        # JSON of the list of ids, made from their column: ids need no escapes.
        for start in range(0, len(self.tasks), _HASHED):
            ids = '", "'.join(self.tasks.ids[start : start + _HASHED].to_pylist())
            state.update(f'{", " if start else ""}"{ids}"'.encode())
        state.update(b"]]")
        return state.hexdigest()


_HASHED = 65_536  # ids per update of the hash


def make_plan(composed: ComposedSweep, catalogue_of: Callable[[Config], Catalogue]) -> tuple[Plan, Config]:
    """Expand a sweep into its tasks.

    Combinations with the same task (a pose attack under several lambda) give one task, at its first place in the order.
    Scenes vary fastest.

    Returns: the plan, and the settings of its first task (for ``runner`` and ``tracking``).

    Raises: InputError: unknown names, unreadable scenes or weights, or an empty set of scenes.
    """
    where = f"sweep {composed.name}"
    catalogues: dict[str, tuple[Catalogue, int]] = {}
    assets: list[AssetsSpec] = []
    builder = TasksBuilder()
    first: Config | None = None
    detectors: list[DetectorConfig] = []
    decided = EffectChoiceCache()
    layouts = LayoutCache(builder, decided, where)
    several = math.prod(len(axis.values) for axis in composed.axes)
    # Decoding takes seconds per vehicle.
    combinations = progress_bar(expand(composed), desc="planning", total=several, leave=False, delay=5.0)
    for config in combinations:
        first = first or config
        key = _assets_key(config)
        if key not in catalogues:
            catalogue = catalogue_of(config)
            detectors.append(config.detector)
            loaded = _assets(config, catalogue)
            if loaded not in assets:
                assets.append(loaded)
            catalogues[key] = (catalogue, assets.index(loaded))
        catalogue, index = catalogues[key]
        spec = _spec(config, catalogue, _vehicle_name(config, catalogue, where))
        builder.add(*layouts.tasks_of(config, catalogue, spec), index, config.effects.label)
    found = [catalogue for catalogue, _ in catalogues.values()]
    require_used(detectors, [name for catalogue in found for name in catalogue.detectors])
    assert first is not None  # an axis has values, and without axes there is one combination
    axes = {axis.key: list(axis.texts) for axis in composed.axes}
    plan = Plan(
        composed.name,
        composed.overrides,
        first.settings(),
        axes,
        builder.tasks(),
        tuple(assets),
        decided.decisions(),
        skipped={name: why for catalogue in found for name, why in catalogue.skipped.items()},
        preview=not all(entry.content_hash for catalogue in found for entry in catalogue.scenes),
        notes=(*dict.fromkeys(note for catalogue in found for note in catalogue.notes), *decided.unused()),
    )
    return plan, first


def _assets_key(config: Config) -> str:
    parts = (config.scenes, config.detector, config.accuracy, config.naturalness)
    # A catalogue checks these settings for some detectors only: every value of such an axis is checked.
    placement = config.attack.placement
    checked = [config.attack.search, placement.min_range_m, placement.max_range_m, config.shift_m]
    if not {ONNX, OWN, *FOREIGN} & set(config.detector.named()):
        checked = []
    return json.dumps([part.model_dump(mode="json") for part in parts] + [_vehicles(config), checked])


def _vehicles(config: Config) -> dict[str, Any]:
    return config.vehicle.model_dump(mode="json", exclude={"name"})


def _assets(config: Config, catalogue: Catalogue) -> AssetsSpec:
    weights = config.detector.weights_by_name()
    return AssetsSpec(
        scenes=config.scenes.model_dump(mode="json"),
        vehicles=_vehicles(config),
        detectors={name: weights.get(name) for name in catalogue.detectors},
        hashes={"decoder": catalogue.decoder_hash, **catalogue.detectors},
        modules=config.detector.modules_by_name(),
        layouts=detector_layouts(config.detector),
        reference=config.naturalness.source(),
    )


def _vehicle_name(config: Config, catalogue: Catalogue, where: str) -> str:
    """Complete a vehicle's name from a unique beginning; the number of a drawn vehicle stays behind it."""
    name, names, where = config.vehicle.name, list(catalogue.vehicles), f"{where}, vehicle.name"
    kind, number = kind_and_number(name)
    for beginning, behind in ((name, ""), (kind, f"-{number}")):
        fitting = [beginning] if beginning in names else [found for found in names if found.startswith(beginning)]
        if len(fitting) == 1:
            return fitting[0] + behind
    if fitting:
        what = f"{len(fitting)} vehicles have a name that begins with {name!r}"
        raise InputError(what, where=where, remedy=f"One of: {', '.join(fitting)}")
    raise messages.choice_error("vehicle", name, names, where)


def _spec(config: Config, catalogue: Catalogue, vehicle: str) -> TaskSpec:
    """Return the spec that the tasks of one combination of settings share.

    Raises: InputError: vehicles may be placed, or moved, beyond the grid of a shipped detector.
    """
    names, range_m = list(catalogue.detectors), config.attack.placement.max_range_m
    require_in_grid(names, catalogue.sector_rad, range_m, config.shift_m)
    attack = config.attack.model_dump(exclude={"alpha", "lambda_", "placement", "transfer_scenes"})
    space_hash = "" if config.mode == "pose" else catalogue.space_hash(vehicle, config.attack)
    if config.mode == "pose":  # settings of shapes must not change the id of a pose attack
        shapes_alone = ("space", "components", "naturalness", "search_scenes", "edit")
        attack |= {name: value for name, value in vars(AttackSpec()).items() if name in shapes_alone}
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
        attack=AttackSpec(**attack, space_hash=space_hash, budget_rule=BUDGET_RULE if attack["naturalness"] else 0),
        placement=placement,
        vehicle_hash=catalogue.vehicles[vehicle],
        decoder_hash=catalogue.decoder_hash,
        scored_by=tuple(catalogue.detectors),
        detector_hashes=catalogue.detectors,
        reference_hash=catalogue.reference_hash,
    )
