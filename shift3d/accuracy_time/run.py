"""Interleaved measurement of all settings on a case, resumed from the case's journal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from shift3d.accuracy_time.journal import Journal
from shift3d.accuracy_time.measure import CaseMeasurer, Outcome
from shift3d.accuracy_time.settings import Setting
from shift3d.accuracy_time.timing import interleaved_samples, num_further_timings

ProgressCallback = Callable[[str, float, bool], None]
"""Progress callback: name of the measurement, its expected seconds when done (else 0), True if already known."""


@dataclass(frozen=True)
class RepeatLimits:
    """Number of timings of a rendering: at most `most`, and at most as many as fit into `seconds`. A rendering slower
    than slow_s is timed once, in its first measurement."""

    most: int
    seconds: float
    slow_s: float


@dataclass(frozen=True)
class CaseResult:
    """Results of one setting on one case; see `measure.CaseMeasurer` for the outcomes.

    displaced: None if the setting skips the displaced shape. attack: None without attacks. steps: times of the attack
    steps, including that of `look`. samples_ms: times of renderings, at least one.
    """

    look: Outcome
    displaced: Outcome | None
    steps: tuple[Outcome, ...]
    samples_ms: tuple[float, ...]
    attack: Outcome | None = None


@dataclass(frozen=True)
class _Measurement:
    """One measurement. name: key in the journal. seconds: expected time for the progress bar. make: runs it."""

    name: str
    setting: Setting
    seconds: float
    make: Callable[[], Any]


def measure_case(
    settings: Sequence[Setting],
    instrument: CaseMeasurer,
    journal: Journal,
    repeats: RepeatLimits,
    tell: ProgressCallback = lambda name, seconds, known: None,
) -> dict[str, CaseResult]:
    """Measure everything missing from the journal, in an order that spreads the machine's drift over all settings.

    tell: progress callback, called before each measurement with 0 seconds and after it with the expected seconds.

    Returns: results by the setting's name.
    """
    _work_off(_looks(settings, instrument), journal, tell)
    _work_off(_more_steps(settings, instrument, journal, repeats), journal, tell)
    alike: dict[str, Setting] = {}  # first setting of each rendering; its first measurement decides the sample count
    for setting in settings:
        alike.setdefault(setting.rendering_key, setting)
    first_ms = {key: journal[f"look/{setting.step_key}"]["render_ms"] for key, setting in alike.items()}
    counts = {
        key: num_further_timings(ms, repeats.most, repeats.seconds, repeats.slow_s) for key, ms in first_ms.items()
    }
    _work_off(_samples(alike, counts, instrument), journal, tell)
    results: dict[str, CaseResult] = {}
    for setting in settings:
        look, key = journal[f"look/{setting.step_key}"], setting.rendering_key
        displaced = journal[f"displaced/{setting.displaced_key}"] if setting.displaced else None
        steps = [look, *(journal[name] for name in _step_names(setting, journal, repeats))]
        samples = [journal[f"sample/{key}/{i}"] for i in range(counts[key])] or [first_ms[key]]
        attack = journal[f"attack/{setting.attack_key}"] if setting.attack_steps else None
        results[setting.name] = CaseResult(look, displaced, tuple(steps), tuple(samples), attack)
    return results


def _work_off(measurements: Iterator[_Measurement], journal: Journal, tell: ProgressCallback) -> None:
    for measurement in measurements:
        known = measurement.name in journal
        tell(measurement.setting.name, 0.0, known)
        if not known:
            journal.put(measurement.name, measurement.make())
        tell(measurement.setting.name, measurement.seconds, known)


def _looks(settings: Sequence[Setting], instrument: CaseMeasurer) -> Iterator[_Measurement]:
    for setting in settings:
        seconds = _seconds(setting)
        wanted = [("look", setting.step_key, instrument.look)]
        wanted += [("displaced", setting.displaced_key, instrument.displaced)] if setting.displaced else []
        wanted += [("attack", setting.attack_key, instrument.attack)] if setting.attack_steps else []
        for kind, key, make in wanted:
            yield _Measurement(f"{kind}/{key}", setting, seconds[kind], partial(make, setting))


def _more_steps(
    settings: Sequence[Setting], instrument: CaseMeasurer, journal: Journal, repeats: RepeatLimits
) -> Iterator[_Measurement]:
    names = {s.name: (s, _step_names(s, journal, repeats)) for s in settings}
    for name, number in interleaved_samples({name: len(found) for name, (_, found) in names.items() if found}):
        setting, found = names[name]
        yield _Measurement(found[number], setting, _seconds(setting)["step"], partial(instrument.step, setting))


def _samples(
    alike: Mapping[str, Setting], counts: Mapping[str, int], instrument: CaseMeasurer
) -> Iterator[_Measurement]:
    for key, number in interleaved_samples({key: count for key, count in counts.items() if count}):
        setting, seconds = alike[key], _seconds(alike[key])["samples"] / counts[key]
        yield _Measurement(f"sample/{key}/{number}", setting, seconds, partial(instrument.sample, setting))


def _step_names(setting: Setting, journal: Journal, repeats: RepeatLimits) -> list[str]:
    """Name the attack steps beyond that of `look`; none for a slow rendering."""
    slow = journal[f"look/{setting.step_key}"]["render_ms"] > 1e3 * repeats.slow_s
    return [] if slow else [f"step/{setting.step_key}/{i}" for i in range(1, setting.steps)]


def _seconds(setting: Setting) -> dict[str, float]:
    """Estimate the time of each measurement on a quiet core without bfloat16, for the progress bar only.

    The bar's remaining time soon follows the measured speed.
    """
    paper = 20.0 if setting.accuracy.get("sphere_chord_only") else 85.0
    by_solver = {"paper": paper, "piecewise_linear": 5.0, "plain_sphere_tracing": 0.7}
    once, window = by_solver.get(str(setting.accuracy["solver"]), 0.4), 4.0 if setting.crop_m is None else 0.3
    return {
        "look": once + 3 * window,
        "displaced": setting.displaced * (once + window),
        "attack": 2.0 * setting.attack_steps * (once + window),
        "step": once + 2 * window,
        "samples": 0.0 if once >= 5.0 else 1.0 + once / 2,
    }


def expected_seconds(settings: Sequence[Setting], cases: int) -> float:
    """Estimate the sum of the seconds that `measure_case` passes to `tell`, over all cases."""
    total = sum(_seconds(s)["samples"] for s in {s.rendering_key: s for s in settings}.values())
    for setting in settings:
        each = _seconds(setting)
        total += each["look"] + each["displaced"] + each["attack"] + (setting.steps - 1) * each["step"]
    return cases * total
