"""Driver of the frontier: places the cases, makes their ground truth, and measures them into one folder."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from shift3d.accuracy_time.cases import Case, place_case
from shift3d.accuracy_time.journal import Journal
from shift3d.accuracy_time.measure import CaseMeasurer
from shift3d.accuracy_time.rows import CaseResults
from shift3d.accuracy_time.run import ProgressCallback, RepeatLimits, expected_seconds, measure_case
from shift3d.accuracy_time.settings import Setting
from shift3d.accuracy_time.timing import machine
from shift3d.accuracy_time.truth import Truth, make_truth, read_truth, write_truth
from shift3d.settings.catalogue.detector_files import detector_hash
from shift3d.store.user_cache import source_digest
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.sources import vehicle_hash

_TRUTH_SECONDS = 25.0
# Code that the measured numbers depend on. Code that only reads settings, or stores or presents numbers, is left out.
_CODE = (
    *("accuracy_time", "attack", "detectors", "geometry", "placement", "processor.py", "render", "scenes", "sdf"),
    *("task", "vehicles"),
)


@dataclass(frozen=True)
class SceneGroup:
    """Scenes of one set. name: name in the table. assets: inputs to load. spec: shape task whose vehicle, scene and
    distances each case replaces."""

    name: str
    assets: AssetsSpec
    spec: TaskSpec


@dataclass(frozen=True)
class FrontierPlan:
    """Plan of the measurements.

    settings: rows of the table. cases: (vehicle, distance in metres) in every group. reference: setting of the ground
    truth; its detector window is wider than that of any setting, whole scenes excepted. search, descent_steps: setting
    and length of the attack that displaces the shape. within_m: tolerance of a vehicle's distance. warm_steps:
    consecutive renderings before a warm rendering is measured.
    """

    settings: tuple[Setting, ...]
    cases: tuple[tuple[str, float], ...]
    reference: Setting
    search: Setting
    repeats: RepeatLimits
    descent_steps: int
    warm_steps: int
    within_m: float

    def expected_seconds(self, groups: int) -> float:
        """Estimate the run time on a core without bfloat16, for the progress bar."""
        number = len(self.cases) * groups
        return expected_seconds(self.settings, number) + number * _TRUTH_SECONDS


def measure_frontier(
    groups: Sequence[SceneGroup], plan: FrontierPlan, folder: Path, again: bool, tell: ProgressCallback
) -> list[CaseResults]:
    """Measure every setting on every case, except measurements that the folder already holds.

    Args:
        folder: output folder. ``measured/`` holds a truth and a journal per case, named by a hash of all dependencies.
        again: delete earlier measurements of all cases before the first new one, but not the truths. A later call
            without it resumes.

    Raises: InputError: missing assets or a case without a place, before any measurement; a full disk.
    """
    held = [(group, load_assets(group.assets)) for group in groups]
    cases = [(group, assets, case) for group, assets in held for case in _cases(group, plan, assets)]
    places = [folder / "measured" / _folder_name(case, plan, assets, group) for group, assets, case in cases]
    for here in places if again else ():
        (here / "journal.jsonl").unlink(missing_ok=True)
    measured = []
    for (group, assets, case), here in zip(cases, places, strict=True):
        truth = _truth(here / "truth.npz", case, plan, assets, tell)
        journal = Journal(here / "journal.jsonl")
        instrument = CaseMeasurer(case, assets, truth, plan.reference, plan.warm_steps, plan.repeats.slow_s)

        def report(name: str, seconds: float, known: bool, where: str = case.name) -> None:
            tell(f"{where}: {name}", seconds, known)

        results = measure_case(plan.settings, instrument, journal, plan.repeats, report)
        undecided = sum(truth.unresolved.values())
        measured.append(CaseResults(group.name, case.beams, results, undecided))
    return measured


def _cases(group: SceneGroup, plan: FrontierPlan, assets: Assets) -> Iterator[Case]:
    for number, (vehicle, range_m) in enumerate(plan.cases):
        near, far = range_m - plan.within_m, range_m + plan.within_m
        where = dataclasses.replace(group.spec.placement, min_range_m=near, max_range_m=far)
        spec = dataclasses.replace(group.spec, vehicle=vehicle, placement=where)
        yield place_case(group.name, number, spec, assets)


def _truth(path: Path, case: Case, plan: FrontierPlan, assets: Assets, tell: ProgressCallback) -> Truth:
    tell(f"{case.name}: truth", 0.0, False)
    if not (known := path.is_file()):
        write_truth(path, make_truth(case, assets, plan.reference, plan.search, plan.descent_steps))
    tell(f"{case.name}: truth", _TRUTH_SECONDS, known)
    return read_truth(path)


def _folder_name(case: Case, plan: FrontierPlan, assets: Assets, group: SceneGroup) -> str:
    """Name a case's folder by all inputs of its measurements, except the settings: the journal's names include them."""
    files, modules, layouts = group.assets.detectors, group.assets.modules, group.assets.layouts
    detectors = {name: detector_hash(name, path, modules.get(name), layouts.get(name)) for name, path in files.items()}
    vehicle = vehicle_hash(assets.vehicle(case.spec))
    options = [plan.reference.step_key, plan.search.step_key, plan.descent_steps, plan.warm_steps]
    parts = [case.spec.canonical_json(), case.theta.tolist(), vehicle, assets.vehicles.decoder_hash(), detectors]
    text = json.dumps([*parts, options, plan.repeats.slow_s, machine(), source_digest(*_CODE), torch.__version__])
    name = re.sub(r"[^\w.-]+", "-", case.name)
    return f"{name}-{hashlib.blake2b(text.encode(), digest_size=6).hexdigest()}"
