"""The specification of one task, and its result.

A :class:`TaskSpec` holds every value that can change a task's result and nothing else: two specs with the
same id give the same bytes. Where a task runs, where files lie and how many workers there are is not in it.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from shift3d.attack.names import SearchName, SpaceName
from shift3d.seeding import derive_seed

# Raised when the same fields come to mean another result (a changed algorithm under unchanged settings).
SPEC_VERSION = 6
# Version 5 names some settings otherwise; its tasks are read and keep their ids.
_READ_VERSIONS = (5, SPEC_VERSION)
_FORMER_EFFECTS = {"silent_beams": "no_return_beams"}

Mode = Literal["shape", "pose", "shape_pose"]


@dataclass(frozen=True)
class PlacementSpec:
    """Where the vehicle may be inserted.

    min_range_m, max_range_m: horizontal distance from the sensor, metres. min_object_points: fewest
    returns on the vehicle. overlap_m: deepest that an original scene point may lie inside the vehicle.
    contact_m: how near the vehicle's surface some original scene point must lie. sector_centre_rad,
    sector_half_width_rad: azimuth range about +x (pi: everywhere). attempts: tries before the task reports
    that nothing fits.

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
    """The search for a hard shape or pose, and the comparisons beside it.

    selection_window: steps before and after that count when one is kept, see `shift3d.attack.loop.best_step`.
    noise_sigma: standard deviation of the codes of ``adversarial_noise``; noise_share: the same as a share of the
    solution's latent distance, where it is above 0. max_shift_m: largest |Δxy| of a pose, metres. max_tilt_rad:
    largest change of pitch and roll from the ground's. below_ground_m: deepest that the vehicle may reach below the
    plane of the ground; 0: only scene points are asked. detection_radius_m: from the vehicle's centre to that of a box
    that detects it.

    search: how it goes; every search has ``steps`` evaluations. space: where a shape may go; components: of space pca;
    space_hash: of the codes or ranges that bound it. rate, placements, starts: of search expectation. random_search: 1
    where the best of as many random draws stands beside the solution, as method ``random_budget``. naturalness: the
    percentile of the reference set that a shape may not pass during the search; 0: any shape. search_scenes: how many
    of the task's transfer scenes, from the first, the loss of a shape is taken over beside its own. edit:
    "NAME:PLACE", a parameter of a parametric decoder's vehicle and where in its kind's range it is put, -1 lowest to 1
    highest, for the method ``edited``. budget_rule: how a search is held within ``naturalness``, `BUDGET_RULE`; 0
    without a budget.

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
        """The search and where it goes, in a word: "descent", "expectation_pca10", "descent_within95_universal4"."""
        space = {"free": "", "pca": f"_pca{self.components}"}.get(self.space, f"_{self.space}")
        budget = f"_within{self.naturalness:g}" if self.naturalness else ""
        scenes = f"_universal{1 + self.search_scenes}" if self.search_scenes else ""
        edit = f"_{self.edit}" if self.edit else ""
        return f"{self.search}{space}{budget}{scenes}{edit}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values. What came later is left out where it is as the paper has it: tasks keep their ids."""
        return {name: value for name, value in vars(self).items() if _LATER.get(name) != value}


def split_label(label: str) -> tuple[str, float | None]:
    """An `AttackSpec.label` without its budget, and the budget: "descent_within95" as ("descent", 95.0)."""
    found = re.search(r"_within([0-9.]+(?:e[+-]?[0-9]+)?)", label)
    return (label, None) if found is None else (label.replace(found.group(), "", 1), float(found.group(1)))


def label_words(label: str) -> str:
    """An `AttackSpec.label` in words, its edit as it is written: "descent family chassis.height_m:-1"."""
    found = _EDITED.fullmatch(label)
    head, edit = (label, "") if found is None else found.groups()
    return f"{head.replace('_', ' ')} {edit}".rstrip()


_EDITED = re.compile(r"([a-z]+(?:_(?:pca\d+|parameters|family))?(?:_within[^_]+)?(?:_universal\d+)?)_(.+:.+)")
BUDGET_RULE = 2
"""Raised when a search within a budget of naturalness comes to another shape under the same settings."""
_LATER = {"search": "descent", "space": "free", "components": 10, "rate": 0.1, "placements": 2, "starts": 1,
          "random_search": 0, "naturalness": 0.0, "noise_share": 0.0, "search_scenes": 0, "edit": "",
          "space_hash": "", "budget_rule": 0, "below_ground_m": 0.0}  # fmt: skip
"""Fields that specs of version 6 had not from the beginning, with the values that leave a task as it was."""


@dataclass(frozen=True)
class TransferScene:
    """Another scene that a shape is put into: its name, the hash of its content, and the effects it calls for."""

    scene: str
    scene_hash: str
    effects: tuple[str, ...] = ()

    @staticmethod
    def of(values: Mapping[str, Any]) -> TransferScene:
        """Of plain values by these names."""
        return TransferScene(values["scene"], values["scene_hash"], tuple(values["effects"]))


@dataclass(frozen=True)
class TaskSpec:
    """One vehicle in one scene, attacked once.

    lambda_: weight of the latent distance; None for a pose task, which has no such term (any value given is
    dropped, so that a sweep over lambda holds each pose task once). alpha: step size. accuracy: a preset's
    name, with accuracy_settings the values that differ from or refine it. effects: names, in physical order; with
    effect_settings what is said about the scene beyond what it states (`scenes.facts.EffectSettings`).
    scene_arguments: what the scene was made from, for the reader of a plan. scored_by: detectors that score every
    solution; the attacked one is put first, whether it is named or not. detector_hashes: of each of them, by name.
    transfer_scenes: other scenes that the adversarial shape is put into; none for a pose task, whose pose belongs to
    its scene. reference_hash: of what the reference set of naturalness is made from; empty: it is not measured. The
    hashes are 128-bit BLAKE2b, hex.
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
        """Plain nested dictionaries, ready for JSON."""
        values = dataclasses.asdict(self) | {"attack": self.attack.to_dict(), "spec_version": SPEC_VERSION}
        if not self.reference_hash:  # the id of a task that measures none is that of a program that could not
            del values["reference_hash"]
        return values

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> TaskSpec:
        """The inverse of :meth:`to_dict`. Raises ValueError for another spec version."""
        values = dict(values)
        version = values.pop("spec_version")
        if version not in _READ_VERSIONS:
            raise ValueError(f"task spec version {version}, this is version {SPEC_VERSION}")
        if version != SPEC_VERSION:
            values = _current(values)
        values["effects"], values["scored_by"] = tuple(values["effects"]), tuple(values["scored_by"])
        values["attack"] = AttackSpec(**values["attack"])
        values["placement"] = PlacementSpec(**values["placement"])
        values["transfer_scenes"] = tuple(map(TransferScene.of, values.get("transfer_scenes", ())))
        return TaskSpec(**values)

    def canonical_json(self) -> str:
        """The one spelling of this spec: keys sorted, no spaces, shortest round-trip floats, no NaN."""
        return json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    @functools.cached_property
    def task_id(self) -> str:
        """128-bit BLAKE2b of :meth:`canonical_json`, hex. Source: our choice (design section 9)."""
        return hashlib.blake2b(self.canonical_json().encode(), digest_size=16).hexdigest()

    @property
    def search(self) -> str:
        """How its search goes, see `AttackSpec.label`; a pose has no space."""
        return self.attack.search if self.mode == "pose" else self.attack.label

    @property
    def placement_seed(self) -> int:
        """64-bit seed of where the vehicle is put: shared by the tasks that should be compared in one place.

        Shape and pose attacks, every lambda, step size, accuracy and detector put the same vehicle at the
        same place of the same scene, so that their differences are paired. Source: our choice: the paper
        is silent.
        """
        what = (self.scene_hash, self.vehicle_hash, self.decoder_hash)
        where = json.dumps(vars(self.placement), sort_keys=True)
        return derive_seed("placement", self.base_seed, self.replicate, *what, where)

    @property
    def baseline(self) -> TaskSpec:
        """What the unchanged vehicle's place and score depend on: the task without its search.

        Equal for tasks that differ in mode, weight, step size or search alone.
        """
        same = ("max_shift_m", "below_ground_m", "detection_radius_m")
        attack = AttackSpec(**{name: getattr(self.attack, name) for name in same})
        return dataclasses.replace(self, mode="pose", alpha=0.0, attack=attack, transfer_scenes=(), reference_hash="")

    def moved_to(self, other: TransferScene, placing_hash: str | None = None) -> TaskSpec:
        """The same task in another scene, for putting what was found there: a place of its own, the same under every
        lambda, step size, accuracy and detector. placing_hash: of the task's scene as its vehicle is placed there,
        None: as the task sees it."""
        here = self if placing_hash is None else dataclasses.replace(self, scene_hash=placing_hash)
        return dataclasses.replace(
            self,
            scene=other.scene,
            scene_hash=other.scene_hash,
            effects=other.effects,
            base_seed=here.placement_seed,
            transfer_scenes=(),
        )


def _current(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a spec of version 5 by the valid names."""
    attack = dict(values["attack"])
    del attack["sphere_m"]
    if "steady_steps" in attack:
        attack["selection_window"] = attack.pop("steady_steps")
    others = [{**other, "effects": _renamed(other["effects"])} for other in values.get("transfer_scenes", ())]
    return {**values, "attack": attack, "effects": _renamed(values["effects"]), "transfer_scenes": others}


def _renamed(effects: Sequence[str]) -> list[str]:
    return [_FORMER_EFFECTS.get(name, name) for name in effects]
