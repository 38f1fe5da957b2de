"""What a worker holds in memory and every task reads: scenes, vehicles, decoder and detectors."""

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
from shift3d.naturalness.measure import Naturalness, NaturalnessMeasure
from shift3d.naturalness.sources import reference_source, source_hash
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
from shift3d.task.kept_grids import kept_grid
from shift3d.task.kept_measures import kept_measures
from shift3d.task.spec import TaskSpec
from shift3d.training.processes import threads
from shift3d.vehicles.sources import VehicleSource, vehicle_hash
from shift3d.vehicles.vehicle import Vehicle

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Tasks come grouped by vehicle, so that the same scenes come round again; a scene with its beams is 15 MB.
_SCENES_KEPT = 16
# An SDF grid of a car is 1 MB and takes seconds.
_SPACES_KEPT = 64


@dataclass
class Assets:
    """Loaded once a worker; never changed by a task.

    scenes, vehicles: the sets that names are looked up in. decoder: float32, as shipped. detectors: name to a file of
    weights (None: those that ship). modules: name to the Python file of a detector of the user's. layouts: name to the
    layout of a foreign one. reference: settings of the reference set of naturalness, None: none. Copies in other
    precisions, scenes with their beams, maps of vehicles and the reference set are made on first use and kept.
    baselines: those last measured, by the id of `TaskSpec.baseline`; see `shift3d.task.baseline`. poses: of places that
    were found, by vehicle, scene and seed; see `shift3d.task.problem`.
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
    _spaces: OrderedDict[tuple[str, RenderSettings], SdfGrid] = field(default_factory=OrderedDict)

    def scene(self, spec: TaskSpec) -> tuple[Scene, Beams]:
        """A task's scene and its beams.

        Raises: InputError for an unknown name, a bad frame, or one that is not what the task was planned with.
        """
        scene, beams, found = self._kept_scene(self.scenes, spec.scene)
        require_planned(f"scene {spec.scene}", spec.scene_hash, found)
        return scene, beams

    def _kept_scene(self, scenes: SceneSet, name: str) -> tuple[Scene, Beams, str]:
        """A scene, its beams and its hash."""
        if name not in self._scenes:
            scene = scenes.load(name)
            self._scenes[name] = (scene, Beams.of_main_sensor(scene), scene.content_hash())
            if len(self._scenes) > _SCENES_KEPT:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(name)
        return self._scenes[name]

    def placing_scene(self, spec: TaskSpec) -> tuple[Scene, Beams, str]:
        """The scene that a task's vehicle is placed in, its beams and hash: the task's own, but for a street that other
        beams see, where it is the street as its own sensor sees it: places are then the same under any beams.

        Raises: InputError as `scene` does.
        """
        own = self.scenes.seen_by_own(spec.scene) if isinstance(self.scenes, StreetScenes) else None
        if own is None:
            return *self.scene(spec), spec.scene_hash
        return self._kept_scene(*own)

    def decoder_of(self, dtype: torch.dtype) -> Decoder | DeepSdfNetwork:
        """The decoder with its parameters in a dtype."""
        if dtype not in self._decoders:
            import copy

            same = dtype == torch.float32
            self._decoders[dtype] = self.decoder if same else copy.deepcopy(self.decoder).to(dtype)
        return self._decoders[dtype]

    def detector_of(self, name: str, precision: str) -> Detector:
        """A detector with its arithmetic in a precision: bfloat16, float32 or float64."""
        if (name, precision) not in self._detectors:
            made_of = self.detectors.get(name), self.modules.get(name), precision, self.layouts.get(name)
            self._detectors[name, precision] = detector_of(name, *made_of)  # type: ignore[arg-type]
        return self._detectors[name, precision]

    def other_detectors(self, spec: TaskSpec) -> dict[str, Detector]:
        """Those that score a task's objects beside the attacked one, by name, at the precision of its scores."""
        return {name: self.detector_of(name, score_precision(spec)) for name in spec.scored_by[1:]}

    def vehicle(self, spec: TaskSpec) -> Vehicle:
        """A task's vehicle.

        Raises: InputError for an unknown one, or one that is not what the task was planned with.
        """
        name = spec.vehicle
        vehicle = self.vehicles.vehicle(name)
        if name not in self._vehicle_hashes:
            self._vehicle_hashes[name] = vehicle_hash(vehicle)
        require_planned(f"vehicle {name}", spec.vehicle_hash, self._vehicle_hashes[name])
        return vehicle

    def naturalness(self, spec: TaskSpec) -> Naturalness | None:
        """What measures naturalness against the task's reference set; None where the task measures none.

        Raises: InputError for a set that cannot be made, or is not what the task was planned with.
        """
        if not spec.reference_hash or self.reference is None:
            return None
        require_planned("the reference set", spec.reference_hash, self._reference_hash)
        return self._naturalness

    @functools.cached_property
    def _decoder_hash(self) -> str:
        return self.vehicles.decoder_hash()

    @functools.cached_property
    def _reference_hash(self) -> str:
        return source_hash(reference_source(self.reference or {}))

    @functools.cached_property
    def _naturalness(self) -> Naturalness:
        return Naturalness(load_reference(reference_source(self.reference or {}), "naturalness"))

    def naturalness_of(self, spec: TaskSpec, name: str) -> NaturalnessMeasure | None:
        """The naturalness of an unchanged vehicle of the task's set, measured on first use."""
        measures = self.naturalness(spec)
        if measures is not None and name not in self._own_naturalness:
            vehicle = self.vehicles.vehicle(name)
            self._own_naturalness[name] = measures.of_code(vehicle, self.decoder, vehicle.latent_code)
        return self._own_naturalness.get(name)

    def naturalness_of_kinds(self, spec: TaskSpec) -> dict[str, NaturalnessMeasure]:
        """The naturalness of every vehicle that a search may turn to, by name; none where the task measures none."""
        if (measures := self.naturalness(spec)) is None:
            return {}
        names = self.vehicles.kinds()
        if not self._own_naturalness.keys() >= set(names):
            self._own_naturalness |= kept_measures(self.vehicles, self.decoder, measures, self._reference_hash)
        return {name: self._own_naturalness[name] for name in names}

    def drawn_vehicle(self, spec: TaskSpec, solution: Mapping[str, Any]) -> Vehicle:
        """The vehicle in whose frame a row of solutions is drawn: the task's own, but for a search over kinds."""
        own, name = self.vehicle(spec), solution.get("drawn_as")
        return self.vehicles.vehicle(name) if isinstance(name, str) and name != own.name else own

    def space_of(self, spec: TaskSpec, settings: RenderSettings) -> SdfGrid | None:
        """An SDF grid of the task's vehicle at these settings, None where they use none.

        Made once a vehicle, or read from the user's cache folder: it depends on its code alone. Whether there is one
        depends on the settings, never on what ran before, so that a task's bytes do not.
        """
        if not settings.sdf_grid or settings.solver != "sphere_tracing":
            return None
        key = (spec.vehicle, settings)
        if key not in self._spaces:
            vehicle = self.vehicle(spec)

            def make() -> SdfGrid:
                code = torch.from_numpy(vehicle.latent_code).to(settings.dtype)
                with torch.no_grad():
                    return SdfGrid.of(self.decoder_of(settings.dtype).field(code), vehicle, settings)

            self._spaces[key] = kept_grid(self._decoder_hash, self._vehicle_hashes[spec.vehicle], settings, make)
            if len(self._spaces) > _SPACES_KEPT:
                self._spaces.popitem(last=False)
        self._spaces.move_to_end(key)
        return self._spaces[key]


def require_planned(what: str, planned: str | None, found: str) -> None:
    """Refuse content with another hash than was planned; a spec made by hand may state none."""
    if planned and planned != found:
        remedy = "Restore it, or start a new sweep in another folder with out=DIR"
        raise InputError("changed after the sweep was planned", where=what, remedy=remedy)


def load_assets(spec: AssetsSpec) -> Assets:
    """Load everything that tasks of a sweep share.

    Raises: InputError: naming the file that is missing or unusable, or weights that are not those of the plan.
    """
    for name, path in spec.detectors.items():
        found = detector_hash(name, path, spec.modules.get(name), spec.layouts.get(name))
        require_planned(f"the weights of {name}", spec.hashes.get(name), found)
    source = vehicle_source(spec.vehicles)
    require_planned("the vehicles' decoder", spec.hashes.get("decoder"), source.decoder_hash())
    scenes = scene_set(scene_config(spec.scenes))
    assets = Assets(scenes, source, source.decoder(), spec.detectors, spec.modules, spec.reference, spec.layouts)
    # Now, not at the first task: weights that do not fit stop the sweep in one line instead of failing every task.
    for name in spec.detectors:
        assets.detector_of(name, "float32")
    return assets


def prepare_naturalness(spec: AssetsSpec, templates: Sequence[TaskSpec]) -> None:
    """Make what tasks compare shapes with now, with a progress bar, so that workers find it in the cache.

    templates: specs of the tasks, without their scene. A search over kinds within a budget needs each kind's measure,
    and a kind that keeps the budget itself; any other search a vehicle that does.
    Raises: InputError for a reference set that cannot be made, or naming the vehicles that lie beyond a budget.
    """
    if spec.reference is None:
        return
    source = reference_source(spec.reference)
    measures = Naturalness(load_reference(source, "naturalness"))
    bounded = [t for t in templates if t.mode != "pose" and t.attack.naturalness > 0]
    if not bounded:
        return
    vehicles = vehicle_source(spec.vehicles)
    with threads(spec.threads):
        if budgets := {t.attack.naturalness for t in bounded if t.attack.space == "family"}:
            kinds = kept_measures(vehicles, vehicles.decoder(), measures, source_hash(source), show=True)
            kinds_within(min(budgets), kinds)
        _require_within([t for t in bounded if t.attack.space != "family"], vehicles, measures)


def _require_within(templates: Sequence[TaskSpec], vehicles: VehicleSource, measures: Naturalness) -> None:
    """Refuse, before anything runs, what each of their tasks would: vehicles that lie beyond the budget unchanged."""
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
    """Names of the kinds that keep a budget of naturalness themselves. Raises InputError where none does."""
    names = [name for name, own in kinds.items() if own.within(budget)]
    if not names:
        nearest = min(kinds, key=lambda name: (len(kinds[name].out_of_range), kinds[name].percentile))
        what = f"no vehicle of the set lies within the budget; the nearest is {_reasons(nearest, kinds[nearest])}"
        where = f"attack.space=family, attack.naturalness={budget:g}"
        raise InputError(what, where, "Give a larger attack.naturalness, or other vehicles")
    return names


def _reasons(name: str, own: NaturalnessMeasure) -> str:
    """A vehicle with what a budget is held against."""
    return f"{name} ({', '.join((f'percentile {own.percentile:.3g}', *own.out_of_range))})"


def render_settings(spec: TaskSpec) -> RenderSettings:
    """The renderer's settings that a task states in plain values; what an older program did not state is the preset's.

    Raises: InputError: no dtype, or a solver that is gone.
    """
    where = f"task {spec.task_id}"
    values = current_settings(spec.accuracy_settings, where)
    values.pop("detector", None)
    if values.get("dtype") not in _DTYPES:
        raise InputError(f"accuracy.render.dtype is {values.get('dtype')!r}", where, "Give float32 or float64")
    values["dtype"] = _DTYPES[values["dtype"]]
    return PRESETS.get(spec.accuracy, STANDARD).with_(**values)


def search_precision(spec: TaskSpec) -> str:
    """Precision of the detector while it is descended."""
    return str(spec.accuracy_settings.get("detector", "float32"))


def score_precision(spec: TaskSpec) -> str:
    """Precision of the detector that scores: float32, or float64 where the search has it too."""
    return "float64" if search_precision(spec) == "float64" else "float32"
