"""Assets: scenes, vehicles, decoder and detectors, which a worker loads once and every task reads."""

from __future__ import annotations

import functools
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from shift3d.detectors.base import Detector
from shift3d.detectors.loading import detector_of
from shift3d.errors import InputError
from shift3d.naturalness.build import load_reference
from shift3d.naturalness.measure import NaturalnessMeasure, NaturalnessMeter
from shift3d.naturalness.sources import reference_source, source_hash
from shift3d.processes import threads
from shift3d.render.beams import Beams
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import PRESETS, STANDARD, RenderSettings
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import SceneSet, StreetScenes
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.deepsdf_network import DeepSdfNetwork
from shift3d.settings.catalogue.detector_files import detector_hash
from shift3d.settings.catalogue.reading import vehicle_source
from shift3d.settings.renamed import current_settings
from shift3d.settings.schema.scenes import scene_config, scene_set
from shift3d.task.exchange import AssetsSpec
from shift3d.task.grid_cache import cached_grid
from shift3d.task.measure_cache import cached_measures
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.sources import VehicleSource, vehicle_hash
from shift3d.vehicles.vehicle import Vehicle

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Tasks are grouped by vehicle, so the same scenes are needed repeatedly; a scene with its beams is 15 MB.
_SCENES_KEPT = 16
# An SDF grid of a car takes 1 MB and some seconds.
_SDF_GRIDS_KEPT = 64


@dataclass
class Assets:
    """Shared inputs of a worker's tasks, loaded once. Tasks do not change them, but they fill the caches.

    scenes, vehicles: sets in which names are looked up. decoder: float32, as shipped. detectors: name to a file of
    weights (None: the shipped weights). modules: name to the Python file of a user's detector. layouts: name to the
    layout of a foreign detector. reference: settings of the reference set of naturalness, None: none. Copies in other
    precisions, scenes with their beams, SDF grids and the reference set are created on first use.
    baselines: the last measured ones, by the id of `TaskSpec.baseline`; see `shift3d.task.baseline`. poses: placements
    by vehicle, scene and seed; see `shift3d.task.problem`.
    """

    scenes: SceneSet
    vehicles: VehicleSource
    decoder: Decoder | DeepSdfNetwork
    detectors: Mapping[str, str | None]
    modules: Mapping[str, str] = field(default_factory=dict)
    reference: Mapping[str, Any] | None = None
    layouts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    baselines: OrderedDict[str, Any] = field(default_factory=OrderedDict)
    poses: dict[tuple[str, str, int], torch.Tensor | None] = field(default_factory=dict)
    _scenes: OrderedDict[str, tuple[Scene, Beams, str]] = field(default_factory=OrderedDict)
    _decoders: dict[torch.dtype, Decoder | DeepSdfNetwork] = field(default_factory=dict)
    _detectors: dict[tuple[str, str], Detector] = field(default_factory=dict)
    _vehicle_hashes: dict[str, str] = field(default_factory=dict)
    _own_naturalness: dict[str, NaturalnessMeasure] = field(default_factory=dict)
    _sdf_grids: OrderedDict[tuple[str, RenderSettings], SdfGrid] = field(default_factory=OrderedDict)

    def scene(self, spec: TaskSpec) -> tuple[Scene, Beams]:
        """Return a task's scene and its beams. Raises: InputError: unknown name, bad frame, or not as planned."""
        scene, beams, found = self._kept_scene(self.scenes, spec.scene)
        require_planned_hash(f"scene {spec.scene}", spec.scene_hash, found)
        return scene, beams

    def _kept_scene(self, scenes: SceneSet, name: str) -> tuple[Scene, Beams, str]:
        if name not in self._scenes:
            scene = scenes.load(name)
            self._scenes[name] = (scene, Beams.of_main_sensor(scene), scene.content_hash())
            if len(self._scenes) > _SCENES_KEPT:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(name)
        return self._scenes[name]

    def placement_scene(self, spec: TaskSpec) -> tuple[Scene, Beams, str]:
        """Return the scene for the task's placement, its beams and hash: the task's own scene, except for a street.

        A street is seen by its own sensor, so that placements are the same under any beams. Raises: as `scene`.
        """
        own = self.scenes.with_own_sensor(spec.scene) if isinstance(self.scenes, StreetScenes) else None
        if own is None:
            return *self.scene(spec), spec.scene_hash
        return self._kept_scene(*own)

    def decoder_of(self, dtype: torch.dtype) -> Decoder | DeepSdfNetwork:
        """Return the decoder with its parameters in a dtype."""
        if dtype not in self._decoders:
            import copy

            same = dtype == torch.float32
            self._decoders[dtype] = self.decoder if same else copy.deepcopy(self.decoder).to(dtype)
        return self._decoders[dtype]

    def detector_of(self, name: str, precision: str) -> Detector:
        """Return a detector that computes in bfloat16, float32 or float64."""
        if (name, precision) not in self._detectors:
            made_of = self.detectors.get(name), self.modules.get(name), precision, self.layouts.get(name)
            self._detectors[name, precision] = detector_of(name, *made_of)  # type: ignore[arg-type]
        return self._detectors[name, precision]

    def other_detectors(self, spec: TaskSpec) -> dict[str, Detector]:
        """Return the detectors that score beside the attacked one, by name, at the task's scoring precision."""
        return {name: self.detector_of(name, score_precision(spec)) for name in spec.scored_by[1:]}

    def vehicle(self, spec: TaskSpec) -> Vehicle:
        """Return a task's vehicle. Raises: InputError: unknown, not as planned, or of another size than its shape."""
        name = spec.vehicle
        vehicle = self.vehicles.vehicle(name)
        if name not in self._vehicle_hashes:
            self.vehicles.check_size(name)
            self._vehicle_hashes[name] = vehicle_hash(vehicle)
        require_planned_hash(f"vehicle {name}", spec.vehicle_hash, self._vehicle_hashes[name])
        return vehicle

    def naturalness(self, spec: TaskSpec) -> NaturalnessMeter | None:
        """Return the naturalness measurement against the task's reference set; None if the task measures none.

        Raises: InputError: a set that cannot be made, or content that differs from the plan.
        """
        if not spec.reference_hash or self.reference is None:
            return None
        require_planned_hash("the reference set", spec.reference_hash, self._reference_hash)
        return self._naturalness

    @functools.cached_property
    def _decoder_hash(self) -> str:
        return self.vehicles.decoder_hash()

    @functools.cached_property
    def _reference_hash(self) -> str:
        return source_hash(reference_source(self.reference or {}))

    @functools.cached_property
    def _naturalness(self) -> NaturalnessMeter:
        return NaturalnessMeter(load_reference(reference_source(self.reference or {}), "naturalness"))

    def naturalness_of(self, spec: TaskSpec, name: str) -> NaturalnessMeasure | None:
        """Return the naturalness of an unchanged vehicle of the task's set; measured on first use."""
        measures = self.naturalness(spec)
        if measures is not None and name not in self._own_naturalness:
            vehicle = self.vehicles.vehicle(name)
            self._own_naturalness[name] = measures.of_code(vehicle, self.decoder, vehicle.latent_code)
        return self._own_naturalness.get(name)

    def naturalness_of_kinds(self, spec: TaskSpec) -> dict[str, NaturalnessMeasure]:
        """Measure, by name, every vehicle that a search may switch to; empty if the task measures none."""
        if (measures := self.naturalness(spec)) is None:
            return {}
        names = self.vehicles.kinds()
        if not self._own_naturalness.keys() >= set(names):
            self._own_naturalness |= cached_measures(self.vehicles, self.decoder, measures, self._reference_hash)
        return {name: self._own_naturalness[name] for name in names}

    def rendered_vehicle(self, spec: TaskSpec, solution: Mapping[str, Any]) -> Vehicle:
        """Return the vehicle whose frame renders a solution; not the task's own if the search switched kind."""
        own, name = self.vehicle(spec), solution.get("drawn_as")
        return self.vehicles.vehicle(name) if isinstance(name, str) and name != own.name else own

    def sdf_grid_of(self, spec: TaskSpec, settings: RenderSettings) -> SdfGrid | None:
        """Return an SDF grid of the task's vehicle at these settings; None if the settings use none.

        The grid depends on the vehicle's code alone; it is made once per vehicle, or read from the user's cache folder.
        The settings alone decide whether a grid is used, never earlier tasks, so that a task's bytes are reproducible.
        """
        if not settings.sdf_grid or settings.solver != "sphere_tracing":
            return None
        key = (spec.vehicle, settings)
        if key not in self._sdf_grids:
            vehicle = self.vehicle(spec)

            def make() -> SdfGrid:
                code = torch.from_numpy(vehicle.latent_code).to(settings.dtype)
                with torch.no_grad():
                    return SdfGrid.of(self.decoder_of(settings.dtype).field(code), vehicle, settings)

            self._sdf_grids[key] = cached_grid(self._decoder_hash, self._vehicle_hashes[spec.vehicle], settings, make)
            if len(self._sdf_grids) > _SDF_GRIDS_KEPT:
                self._sdf_grids.popitem(last=False)
        self._sdf_grids.move_to_end(key)
        return self._sdf_grids[key]


def require_planned_hash(what: str, planned: str | None, found: str) -> None:
    """Refuse content whose hash differs from the plan's; a spec made by hand may have no hash."""
    if planned and planned != found:
        remedy = "Restore it, or start a new sweep in another folder with out=DIR"
        raise InputError("changed after the sweep was planned", where=what, remedy=remedy)


def load_assets(spec: AssetsSpec) -> Assets:
    """Load everything that the tasks of a sweep share.

    Raises: InputError: names the file that is missing or unusable, or weights that differ from the plan.
    """
    for name, path in spec.detectors.items():
        found = detector_hash(name, path, spec.modules.get(name), spec.layouts.get(name))
        require_planned_hash(f"the weights of {name}", spec.hashes.get(name), found)
    source = vehicle_source(spec.vehicles)
    require_planned_hash("the vehicles' decoder", spec.hashes.get("decoder"), source.decoder_hash())
    scenes = scene_set(scene_config(spec.scenes))
    assets = Assets(scenes, source, source.decoder(), spec.detectors, spec.modules, spec.reference, spec.layouts)
    # Load detectors before the first task: unusable weights stop the sweep once instead of failing every task.
    for name in spec.detectors:
        assets.detector_of(name, "float32")
    return assets


def prepare_naturalness(spec: AssetsSpec, templates: Sequence[TaskSpec]) -> None:
    """Compute the reference set and the measures of kinds with a progress bar; workers then read them from the cache.

    templates: specs of the tasks, without their scene. A search over kinds within a budget needs every kind's measure,
    and a kind within the budget; any other search needs a vehicle within the budget.
    Raises: InputError for a reference set that cannot be made, or naming the vehicles beyond a budget.
    """
    if spec.reference is None:
        return
    source = reference_source(spec.reference)
    measures = NaturalnessMeter(load_reference(source, "naturalness"))
    bounded = [t for t in templates if t.mode != "pose" and t.attack.naturalness > 0]
    if not bounded:
        return
    vehicles = vehicle_source(spec.vehicles)
    with threads(spec.threads):
        if budgets := {t.attack.naturalness for t in bounded if t.attack.space == "family"}:
            kinds = cached_measures(vehicles, vehicles.decoder(), measures, source_hash(source), show=True)
            kinds_within(min(budgets), kinds)
        _require_within([t for t in bounded if t.attack.space != "family"], vehicles, measures)


def _require_within(templates: Sequence[TaskSpec], vehicles: VehicleSource, measures: NaturalnessMeter) -> None:
    """Refuse vehicles that lie beyond the budget unchanged, before tasks run that would all refuse them."""
    budgets: dict[str, set[float]] = {}
    for template in templates:
        budgets.setdefault(template.vehicle, set()).add(template.attack.naturalness)
    beyond = []
    for name, wanted in budgets.items():
        vehicle = vehicles.vehicle(name)
        own = measures.of_code(vehicle, vehicles.decoder(), vehicle.latent_code)
        if missed := [f"{budget:g}" for budget in sorted(wanted) if not own.within(budget)]:
            beyond.append(f"{_reasons(name, own)} beyond {' and '.join(missed)}")
    if beyond:
        what = f"unchanged vehicles lie beyond the budget: {'; '.join(beyond)}"
        raise InputError(what, "attack.naturalness", "Give a larger budget, or leave these vehicles out")


def kinds_within(budget: float, kinds: Mapping[str, NaturalnessMeasure]) -> list[str]:
    """Return the names of the kinds within a budget of naturalness. Raises InputError if there are none."""
    names = [name for name, own in kinds.items() if own.within(budget)]
    if not names:
        nearest = min(kinds, key=lambda name: (len(kinds[name].out_of_range), kinds[name].percentile))
        what = f"no vehicle of the set lies within the budget; the nearest is {_reasons(nearest, kinds[nearest])}"
        where = f"attack.space=family, attack.naturalness={budget:g}"
        raise InputError(what, where, "Give a larger attack.naturalness, or other vehicles")
    return names


def _reasons(name: str, own: NaturalnessMeasure) -> str:
    """Describe a vehicle's measures that a budget limits."""
    return f"{name} ({', '.join((f'percentile {own.percentile:.3g}', *own.out_of_range))})"


def render_settings(spec: TaskSpec) -> RenderSettings:
    """Build the renderer's settings from a task's plain values; the preset supplies values missing in older specs.

    Raises: InputError: an invalid dtype, or a solver that does not exist.
    """
    where = f"task {spec.task_id}"
    values = current_settings(spec.accuracy_settings, where)
    values.pop("detector", None)
    if values.get("dtype") not in _DTYPES:
        raise InputError(f"accuracy.render.dtype is {values.get('dtype')!r}", where, "Give float32 or float64")
    values["dtype"] = _DTYPES[values["dtype"]]
    return PRESETS.get(spec.accuracy, STANDARD).with_(**values)


def search_precision(spec: TaskSpec) -> str:
    """Return the detector's precision during the search."""
    return str(spec.accuracy_settings.get("detector", "float32"))


def score_precision(spec: TaskSpec) -> str:
    """Return the precision of scoring detectors: float64 if the search uses it, else float32."""
    return "float64" if search_precision(spec) == "float64" else "float32"
