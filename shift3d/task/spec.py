"""Specification of one task.

A :class:`TaskSpec` holds every value that can change a task's result and nothing else: two specs with the same id give
the same bytes. It does not hold the machine, file paths or the number of workers.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from shift3d.attack.names import SearchName, SpaceName
from shift3d.seeding import derive_seed

# Raised if the same fields give another result (a changed algorithm under unchanged settings).
SPEC_VERSION = 6
# Tasks of these versions can be read. They keep their ids.
_OLDEST_VERSION = 5
_FORMER_EFFECTS = {"silent_beams": "no_return_beams"}

Mode = Literal["shape", "pose", "shape_pose"]


@dataclass(frozen=True)
class PlacementSpec:
    """Rules for the vehicle's placement.

    min_range_m, max_range_m: horizontal distance from the sensor, metres. min_object_points: fewest returns on the
    vehicle. overlap_m: largest depth of an original scene point inside the vehicle. contact_m: largest distance of the
    nearest original scene point from the vehicle's surface. sector_centre_rad, sector_half_width_rad: azimuth range
    about +x (pi: all directions). attempts: draws before the task reports that no place fits.
    Source: SHIFT3D section Setup and section Hyper-parameters; sector and attempts are our choice.
    """

    min_range_m: float = 15.0
    max_range_m: float = 50.0
    min_object_points: int = 300
    overlap_m: float = 0.02
    contact_m: float = 0.02
    sector_centre_rad: float = 0.0
    sector_half_width_rad: float = 3.141592653589793
    attempts: int = 400


@dataclass(frozen=True)
class AttackSpec:
    """The search for a hard shape or pose, and the methods for comparison.

    selection_window: number of neighbouring steps for choosing the kept step, see `shift3d.attack.loop.best_step`.
    noise_sigma: standard deviation of the codes of ``adversarial_noise``; noise_share: the same as a share of the
    solution's latent distance, used if above 0. max_shift_m: largest |Δxy| of a pose, metres. max_tilt_rad: largest
    change of pitch and roll from the ground's. below_ground_m: largest depth of the vehicle below the ground plane; 0:
    only scene points limit it. detection_radius_m: largest distance of a detecting box's centre from the vehicle's.

    search: algorithm; every search has ``steps`` evaluations. space: allowed codes; components: of space pca;
    space_hash: of the codes or ranges that bound the space. rate, placements, starts: of search expectation.
    random_search: 1 adds the best of as many random draws as method ``random_budget``. naturalness: highest percentile
    of the reference set for a shape during the search; 0: any shape. search_scenes: number of transfer scenes, from the
    first, whose losses are averaged with the task's own. edit: "NAME:PLACE" for method ``edited``: a parameter of a
    parametric decoder's vehicle and its place in the kind's range, -1 lowest to 1 highest. budget_rule: `BUDGET_RULE`,
    the version of the rule for ``naturalness``; 0 without a budget.
    Source: SHIFT3D sections Hyper-parameters, Evaluation Metrics and Adversarial Pose Generation Results; searches but
    descent, and spaces but free, are our choice.
    """

    steps: int = 40
    selection_window: int = 0
    random_replicates: int = 1
    noise_replicates: int = 10
    noise_sigma: float = 0.01
    max_shift_m: float = 4.0
    max_tilt_rad: float = 0.1
    below_ground_m: float = 0.0
    detection_radius_m: float = 5.0
    search: SearchName = "descent"
    space: SpaceName = "free"
    components: int = 10
    rate: float = 0.1
    placements: int = 2
    starts: int = 1
    random_search: int = 0
    naturalness: float = 0.0
    noise_share: float = 0.0
    search_scenes: int = 0
    edit: str = ""
    space_hash: str = ""
    budget_rule: int = 0

    @property
    def label(self) -> str:
        """Short name of search and space: "descent", "expectation_pca10", "descent_within95_universal4"."""
        space = {"free": "", "pca": f"_pca{self.components}"}.get(self.space, f"_{self.space}")
        budget = f"_within{self.naturalness:g}" if self.naturalness else ""
        scenes = f"_universal{1 + self.search_scenes}" if self.search_scenes else ""
        edit = f"_{self.edit}" if self.edit else ""
        return f"{self.search}{space}{budget}{scenes}{edit}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values. A later field is left out at its default, so that earlier tasks keep their ids."""
        values = vars(self).items()
        return {name: value for name, value in values if name in _FIRST or value != getattr(type(self), name)}


def split_label(label: str) -> tuple[str, float | None]:
    """Split an `AttackSpec.label` from its budget: "descent_within95" gives ("descent", 95.0)."""
    found = re.search(r"_within([0-9.]+(?:e[+-]?[0-9]+)?)", label)
    return (label, None) if found is None else (label.replace(found.group(), "", 1), float(found.group(1)))


def label_words(label: str) -> str:
    """Return an `AttackSpec.label` in words, the edit unchanged: "descent family chassis.height_m:-1"."""
    found = _EDITED.fullmatch(label)
    head, edit = (label, "") if found is None else found.groups()
    return f"{head.replace('_', ' ')} {edit}".rstrip()


_SPACES = "|".join(rf"{name}\d*" for name in get_args(SpaceName))
_EDITED = re.compile(
    rf"((?:{'|'.join(get_args(SearchName))})(?:_(?:{_SPACES}))?(?:_within[^_]+)?(?:_universal\d+)?)_(.+:.+)"
)
BUDGET_RULE = 2
"""Raised if a search within a budget of naturalness gives another shape under the same settings."""
_FIRST = ("steps", "selection_window", "random_replicates", "noise_replicates", "noise_sigma", "max_shift_m",
          "max_tilt_rad", "detection_radius_m")  # fmt: skip
"""Fields of version 6 from its start. The default of any other field leaves an earlier task unchanged."""


@dataclass(frozen=True)
class TransferScene:
    """Another scene that a shape is put into: its name, the hash of its content, and the effects that it uses."""

    scene: str
    scene_hash: str
    effects: tuple[str, ...] = ()

    @staticmethod
    def of(values: Mapping[str, Any]) -> TransferScene:
        """Create from plain values by these names."""
        return TransferScene(values["scene"], values["scene_hash"], tuple(values["effects"]))


@dataclass(frozen=True)
class TaskSpec:
    """One attack on one vehicle in one scene.

    lambda_: weight of the latent distance; None for a pose task, which has no such term (a given value is dropped, so
    that a sweep over lambda holds each pose task once). alpha: step size. accuracy: name of a preset;
    accuracy_settings: values that differ from or refine it. effects: names, in physical order; effect_settings:
    additional facts about the scene (`scenes.facts.EffectSettings`). scene_arguments: origin of the scene, for readers
    of a plan. scored_by: detectors that score every solution; the attacked one is always included, first.
    detector_hashes: of each of them, by name. transfer_scenes: other scenes that the adversarial shape is put into;
    none for a pose task, whose pose belongs to its scene. reference_hash: of the source of the reference set of
    naturalness; empty: naturalness is not measured. The hashes are 128-bit BLAKE2b, hex.
    """

    vehicle: str
    scene: str
    dataset: str
    mode: Mode
    lambda_: float | None
    alpha: float
    detector: str
    accuracy: str
    base_seed: int = 0
    replicate: int = 0
    effects: tuple[str, ...] = ()
    effect_settings: Mapping[str, float] = field(default_factory=dict)
    accuracy_settings: Mapping[str, Any] = field(default_factory=dict)
    scene_arguments: Mapping[str, Any] = field(default_factory=dict)
    attack: AttackSpec = AttackSpec()
    placement: PlacementSpec = PlacementSpec()
    scene_hash: str = ""
    vehicle_hash: str = ""
    decoder_hash: str = ""
    scored_by: tuple[str, ...] = ()
    detector_hashes: Mapping[str, str] = field(default_factory=dict)
    transfer_scenes: tuple[TransferScene, ...] = ()
    reference_hash: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "scored_by", tuple(dict.fromkeys((self.detector, *self.scored_by))))
        if self.mode == "pose":
            object.__setattr__(self, "lambda_", None)
            object.__setattr__(self, "transfer_scenes", ())

    def to_dict(self) -> dict[str, Any]:
        """Return plain nested dictionaries, ready for JSON."""
        values = dataclasses.asdict(self) | {"attack": self.attack.to_dict(), "spec_version": SPEC_VERSION}
        if not self.reference_hash:  # without it the id equals that of earlier specs, which lack the field
            del values["reference_hash"]
        return values

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> TaskSpec:
        """Invert :meth:`to_dict`, also of an older version. Raises ValueError for a version that cannot be read."""
        values = dict(values)
        version = values.pop("spec_version")
        if type(version) is not int or not _OLDEST_VERSION <= version <= SPEC_VERSION:
            raise ValueError(f"task spec version {version}, this program reads {_OLDEST_VERSION} to {SPEC_VERSION}")
        for number in range(version, SPEC_VERSION):
            values = _TO_NEXT[number](values) if number in _TO_NEXT else values
        values["effects"], values["scored_by"] = tuple(values["effects"]), tuple(values["scored_by"])
        values["attack"] = AttackSpec(**values["attack"])
        values["placement"] = PlacementSpec(**values["placement"])
        values["transfer_scenes"] = tuple(map(TransferScene.of, values.get("transfer_scenes", ())))
        return TaskSpec(**values)

    def canonical_json(self) -> str:
        """Return the canonical JSON: keys sorted, no spaces, shortest round-trip floats, no NaN."""
        return json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    @functools.cached_property
    def task_id(self) -> str:
        """128-bit BLAKE2b of :meth:`canonical_json`, hex. Source: our choice (design section 9)."""
        return hashlib.blake2b(self.canonical_json().encode(), digest_size=16).hexdigest()

    @property
    def search(self) -> str:
        """Short name of the search, see `AttackSpec.label`; for a pose without a space."""
        return self.attack.search if self.mode == "pose" else self.attack.label

    @property
    def placement_seed(self) -> int:
        """64-bit seed of the vehicle's placement, shared by tasks that should be compared at one place.

        Shape and pose attacks, every lambda, step size, accuracy and detector put the same vehicle at the same place of
        the same scene, so that their differences are paired. Source: our choice: the paper is silent.
        """
        what = (self.scene_hash, self.vehicle_hash, self.decoder_hash)
        where = json.dumps(vars(self.placement), sort_keys=True)
        return derive_seed("placement", self.base_seed, self.replicate, *what, where)

    @property
    def baseline(self) -> TaskSpec:
        """The task without its search: the inputs of the unchanged vehicle's place and score.

        Equal for tasks that differ in mode, weight, step size or search alone.
        """
        same = ("max_shift_m", "below_ground_m", "detection_radius_m")
        attack = AttackSpec(**{name: getattr(self.attack, name) for name in same})
        return dataclasses.replace(self, mode="pose", alpha=0.0, attack=attack, transfer_scenes=(), reference_hash="")

    def moved_to(self, other: TransferScene, placing_hash: str | None = None) -> TaskSpec:
        """Return the task in another scene, at one place for every lambda, step size, accuracy and detector.

        placing_hash: hash of the task's scene as used for the placement; None: of the scene as the task sees it.
        """
        here = self if placing_hash is None else dataclasses.replace(self, scene_hash=placing_hash)
        return dataclasses.replace(
            self,
            scene=other.scene,
            scene_hash=other.scene_hash,
            effects=other.effects,
            base_seed=here.placement_seed,
            transfer_scenes=(),
        )


def is_current(values: Mapping[str, Any]) -> bool:
    """True if the values have SPEC_VERSION, so that the id of their task can be computed again."""
    return bool(values["spec_version"] == SPEC_VERSION)


def _to_version_6(values: Mapping[str, Any]) -> dict[str, Any]:
    """Rename the fields of a version 5 spec."""
    attack = dict(values["attack"])
    del attack["sphere_m"]
    if "steady_steps" in attack:
        attack["selection_window"] = attack.pop("steady_steps")
    others = [{**other, "effects": _renamed(other["effects"])} for other in values.get("transfer_scenes", ())]
    return {**values, "attack": attack, "effects": _renamed(values["effects"]), "transfer_scenes": others}


_TO_NEXT = {5: _to_version_6}
"""Converters of the fields to the next version, by version; none for a version whose fields the next one keeps."""


def _renamed(effects: Sequence[str]) -> list[str]:
    return [_FORMER_EFFECTS.get(name, name) for name in effects]
