"""Naturalness of a set's vehicles in the cache folder: the bits of the first measurement, no torn or foreign file."""

from __future__ import annotations

import contextlib
import io
import math
import shutil
from dataclasses import replace
from pathlib import Path, PurePath

import numpy as np
import pytest
import torch
from short_tasks import STREET, WIDE, make_spec

from shift3d.errors import InputError
from shift3d.naturalness.build import reference_file
from shift3d.naturalness.measure import NO_SURFACE_MEASURE, NaturalnessMeasure, NaturalnessMeter
from shift3d.naturalness.reference import NearestMember
from shift3d.naturalness.sizes import Sizes
from shift3d.naturalness.sources import reference_source, source_hash
from shift3d.task.assets import Assets, prepare_naturalness
from shift3d.task.exchange import AssetsSpec
from shift3d.task.measure_cache import cached_measures
from shift3d.task.run import run_task
from shift3d.task.spec import AttackSpec, TaskSpec
from shift3d.vehicles.sources import VehicleSet, VehicleSource

FAMILY = AttackSpec(steps=2, random_replicates=0, noise_replicates=0, search="random", space="family", naturalness=95)
SHAPE = NaturalnessMeasure(
    NearestMember(7, "a car", (0.1 + 0.2, 1 / 3), (2.0, 3.0)), Sizes(4.5, 1.8, 1.5, math.nan, 0.1), 1 / 7, 0.95
)
SPEC = AssetsSpec(scenes=STREET, reference=WIDE)


class Counted(NaturalnessMeter):
    """Meter that returns the same measure for every vehicle, and counts the calls."""

    def __init__(self, answer: NaturalnessMeasure = SHAPE) -> None:
        self.answer, self.measured = answer, 0

    def of_code(self, *_: object) -> NaturalnessMeasure:
        self.measured += 1
        return self.answer


@pytest.fixture(autouse=True)
def cache(wide_reference: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Cache folder of measures, which holds only the reference set at first."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(shutil.copytree(wide_reference, tmp_path / "cache")))
    return tmp_path / "cache" / "shift3d" / "natural_kinds"


@pytest.fixture(scope="module")
def shipped() -> VehicleSource:
    return VehicleSet()


@pytest.fixture(scope="module")
def driven(wide_reference: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache folder in which the driver measured every kind, to copy, and what it printed meanwhile."""
    folder = shutil.copytree(wide_reference, tmp_path_factory.mktemp("driven") / "cache")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(io.StringIO()) as printed:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        prepare_naturalness(SPEC, [make_spec(attack=FAMILY)])
    return Path(folder), printed.getvalue()


@pytest.fixture
def worker(driven: tuple[Path, str], referenced: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Assets:
    """Assets of a worker that measured nothing yet, beside the driver's cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(shutil.copytree(driven[0], tmp_path / "driven")))
    return replace(referenced, _own_naturalness={})


def kept(vehicles: VehicleSource, measures: Counted, reference: str = "r") -> dict[str, NaturalnessMeasure]:
    return cached_measures(vehicles, vehicles.decoder(), measures, reference)


@pytest.mark.parametrize("answer", [SHAPE, NO_SURFACE_MEASURE])
def test_what_is_read_is_what_was_measured_to_the_bit(shipped: VehicleSource, answer: NaturalnessMeasure) -> None:
    measures = Counted(answer)
    first = kept(shipped, measures)
    again = kept(shipped, Counted(SHAPE))
    assert list(first) == list(again) == shipped.kinds() and measures.measured == len(first)
    assert {name: repr(measure) for name, measure in again.items()} == dict.fromkeys(first, repr(answer))


def test_another_reference_set_is_measured_anew(shipped: VehicleSource) -> None:
    kept(shipped, Counted())
    assert kept(shipped, other := Counted(), "another") and other.measured


def test_code_that_makes_another_reference_set_measures_anew(
    shipped: VehicleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A measure compares with the members of the set, so it depends on everything that determines them."""
    made: list[str] = []
    measured: list[str] = []
    monkeypatch.setattr("shift3d.naturalness.build.program_digest", lambda *parts: made.extend(parts) or "digest")
    monkeypatch.setattr("shift3d.task.measure_cache.program_digest", lambda *parts: measured.extend(parts) or "digest")
    reference_file(reference_source(WIDE))
    kept(shipped, Counted())
    assert made and all(any(PurePath(part).is_relative_to(whole) for whole in measured) for part in made)


def test_other_threads_and_another_machine_may_round_differently(
    shipped: VehicleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept(shipped, Counted())
    for place, found in {"torch.get_num_threads": 7, "platform.node": "another"}.items():
        with monkeypatch.context() as patch:
            patch.setattr(place, lambda found=found: found)
            assert kept(shipped, other := Counted()) and other.measured


@pytest.mark.parametrize("harm", ["torn", "changed", "empty"])
def test_a_file_that_is_torn_or_changed_is_made_again(shipped: VehicleSource, cache: Path, harm: str) -> None:
    kept(shipped, Counted())
    (file,) = cache.iterdir()
    text = file.read_text()
    file.write_text({"torn": text[:-9], "changed": text.replace("a car", "a cat"), "empty": ""}[harm])
    kept(shipped, again := Counted())
    assert again.measured and file.read_text() == text


def test_the_driver_measures_every_kind_before_the_workers(
    driven: tuple[Path, str], worker: Assets, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver measures once, with a bar and the workers' threads: a worker then measures its found shapes alone."""
    spec = make_spec(attack=FAMILY, lambda_=0.0, reference_hash=source_hash(reference_source(WIDE)))
    assert "measuring how natural each vehicle is" in driven[1]
    threads = torch.get_num_threads()
    prepare_naturalness(SPEC, [spec])
    assert torch.get_num_threads() == threads
    torch.set_num_threads(SPEC.threads)
    try:
        wanted = worker.naturalness(spec).of_code  # type: ignore[union-attr]
        vehicle = worker.vehicles.vehicle("coupe")
        directly = wanted(vehicle, worker.decoder, vehicle.latent_code)
        codes = measured_codes(monkeypatch)
        assert repr(worker.naturalness_of_kinds(spec)["coupe"]) == repr(directly) and not codes
        run_task(spec, worker)
        own = [worker.vehicles.vehicle(name).latent_code for name in worker.vehicles.kinds()]
        assert codes and not any(np.array_equal(code, known) for code in codes for known in own)
    finally:
        torch.set_num_threads(threads)


def measured_codes(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Record the codes measured from this point on."""
    codes: list[np.ndarray] = []
    measure = NaturalnessMeter.of_code

    def counted(self: NaturalnessMeter, vehicle: object, decoder: object, code: object) -> NaturalnessMeasure:
        codes.append(np.asarray(code, np.float32))
        return measure(self, vehicle, decoder, code)  # type: ignore[arg-type]

    monkeypatch.setattr(NaturalnessMeter, "of_code", counted)
    return codes


@pytest.mark.parametrize("attack", [FAMILY, AttackSpec(naturalness=95), AttackSpec(search="random", space="family")])
def test_kinds_are_measured_where_a_budget_chooses_among_them_alone(
    attack: AttackSpec, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    natural = replace(SHAPE, sizes=Sizes(4.5, 1.8, 1.5, 0.2, 0.1))
    monkeypatch.setattr(NaturalnessMeter, "of_code", Counted(natural).of_code)
    prepare_naturalness(SPEC, [make_spec(attack=attack), pose_of(attack)])
    assert cache.exists() == (attack is FAMILY)


def pose_of(attack: AttackSpec) -> TaskSpec:
    return make_spec("pose", attack=attack)


def test_a_search_over_kinds_without_a_budget_measures_none(cache: Path, referenced: Assets) -> None:
    attack = AttackSpec(steps=1, random_replicates=0, noise_replicates=0, search="random", space="family")
    spec = make_spec(attack=attack, lambda_=0.0, reference_hash=source_hash(reference_source(WIDE)))
    assert run_task(spec, replace(referenced, _own_naturalness={})).shapes
    assert not cache.exists()


def test_vehicles_beyond_their_budget_are_named_before_anything_runs() -> None:
    """All their tasks would fail, except those of a pose and of a search over kinds."""
    tight = AttackSpec(naturalness=1e-6)
    prepare_naturalness(SPEC, [make_spec("pose", attack=tight), make_spec(attack=AttackSpec(naturalness=100.0))])
    templates = [make_spec(vehicle=name, attack=tight) for name in ("suv", "coupe")]
    with pytest.raises(InputError, match=r"suv \(percentile [\d.]+\) beyond 1e-06; coupe \(.*larger budget"):
        prepare_naturalness(SPEC, [*templates, make_spec(attack=AttackSpec(naturalness=100.0))])


def test_a_budget_that_no_kind_keeps_is_refused_before_anything_runs(worker: Assets) -> None:
    """Each of its tasks would fail, and no other value of an axis helps. A task alone gives the same error."""
    tight = make_spec(attack=replace(FAMILY, naturalness=1e-6), reference_hash=source_hash(reference_source(WIDE)))
    prepare_naturalness(SPEC, [make_spec(attack=FAMILY)])
    error = r"space=family, attack\.naturalness=1e-06: no vehicle.*nearest is \w+ \(percentile [\d.]+\)\. Give a larger"
    with pytest.raises(InputError, match=error):
        prepare_naturalness(SPEC, [make_spec(attack=FAMILY), tight])
    with pytest.raises(InputError, match=error):
        run_task(tight, worker)
