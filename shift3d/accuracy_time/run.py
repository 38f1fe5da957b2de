"""All settings on all cases, interleaved, and taken up again where an earlier run stopped."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from shift3d.accuracy_time.journal import Journal
from shift3d.accuracy_time.measure import Outcome
from shift3d.accuracy_time.settings import Setting
from shift3d.accuracy_time.timing import turns, wanted_samples

Tell = Callable[[str, float, bool], None]


class Instrument(Protocol):
    """Measures settings on one case; see `measure.CaseInstrument`."""

    def look(self, setting: Setting) -> Outcome: ...
    def step(self, setting: Setting) -> Outcome: ...
    def displaced(self, setting: Setting) -> Outcome: ...
    def attack(self, setting: Setting) -> Outcome: ...
    def sample(self, setting: Setting) -> float: ...


@dataclass(frozen=True)
class Repeats:
    """How often a rendering is timed: at most `most` times, and no more often than fits into `seconds`; once, by its
    first look, where it takes longer than slow_s."""

    most: int
    seconds: float
    slow_s: float


@dataclass(frozen=True)
class CaseResult:
    """What one setting came to on one case; see `measure.CaseInstrument` for the outcomes.

    displaced: None where the setting leaves that shape out. attack: None where it makes no attacks. steps: times of
    attack steps, the first look's among them. samples_ms: of renderings, at least one.
    """

    look: Outcome
    displaced: Outcome | None
    steps: tuple[Outcome, ...]
    samples_ms: tuple[float, ...]
    attack: Outcome | None = None


@dataclass(frozen=True)
class _Measurement:
    """Something to measure under a name in the journal. seconds: about how long it takes, for the progress bar."""

    name: str
    setting: Setting
    seconds: float
    make: Callable[[], Any]


def measure_case(
    settings: Sequence[Setting],
    instrument: Instrument,
    journal: Journal,
    repeats: Repeats,
    tell: Tell = lambda name, seconds, known: None,
) -> dict[str, CaseResult]:
    """Measure what is not in the journal yet, in an order that spreads drift over all settings.

    Args: tell: called with a setting's name, how many expected seconds are done with what was measured, and whether
    that was in the journal already; before each measurement with no seconds.

    Returns: By the setting's name.
    """
    for measurements in (_looks(settings, instrument), _more_steps(settings, instrument, journal, repeats)):
        _work_off(measurements, journal, tell)
    _work_off(_samples(settings, instrument, journal, repeats), journal, tell)
    results: dict[str, CaseResult] = {}
    for setting in settings:
        look = journal[f"look/{setting.step_key}"]
        displaced = journal[f"displaced/{setting.displaced_key}"] if setting.displaced else None
        steps = [look, *(journal[name] for name in _step_names(setting, journal, repeats))]
        count = _sample_count(setting, settings, journal, repeats)
        samples = [journal[f"sample/{setting.rendering_key}/{i}"] for i in range(count)]
        if not samples:
            samples = [journal[f"look/{_first_alike(setting, settings).step_key}"]["render_ms"]]
        attack = journal[f"attack/{setting.attack_key}"] if setting.attack_steps else None
        results[setting.name] = CaseResult(look, displaced, tuple(steps), tuple(samples), attack)
    return results


def _work_off(measurements: Iterator[_Measurement], journal: Journal, tell: Tell) -> None:
    for measurement in measurements:
        known = measurement.name in journal
        tell(measurement.setting.name, 0.0, known)
        if not known:
            journal.put(measurement.name, measurement.make())
        tell(measurement.setting.name, measurement.seconds, known)


def _looks(settings: Sequence[Setting], instrument: Instrument) -> Iterator[_Measurement]:
    for setting in settings:
        once, window = _rendering_seconds(setting), _window_seconds(setting)
        yield _Measurement(f"look/{setting.step_key}", setting, once + 3 * window, partial(instrument.look, setting))
        if setting.displaced:
            name = f"displaced/{setting.displaced_key}"
            yield _Measurement(name, setting, once + window, partial(instrument.displaced, setting))
        if setting.attack_steps:
            name = f"attack/{setting.attack_key}"
            yield _Measurement(name, setting, _attack_seconds(setting), partial(instrument.attack, setting))


def _more_steps(
    settings: Sequence[Setting], instrument: Instrument, journal: Journal, repeats: Repeats
) -> Iterator[_Measurement]:
    names = {s.name: (s, _step_names(s, journal, repeats)) for s in settings}
    for name, number in turns({name: len(found) for name, (_, found) in names.items() if found}):
        setting, found = names[name]
        seconds = _rendering_seconds(setting) + 2 * _window_seconds(setting)
        yield _Measurement(found[number], setting, seconds, partial(instrument.step, setting))


def _samples(
    settings: Sequence[Setting], instrument: Instrument, journal: Journal, repeats: Repeats
) -> Iterator[_Measurement]:
    by_key: dict[str, Setting] = {}
    for setting in settings:
        by_key.setdefault(setting.rendering_key, setting)
    counts = {key: _sample_count(setting, settings, journal, repeats) for key, setting in by_key.items()}
    for key, number in turns({key: count for key, count in counts.items() if count}):
        setting, seconds = by_key[key], _timing_seconds(by_key[key]) / counts[key]
        yield _Measurement(f"sample/{key}/{number}", setting, seconds, partial(instrument.sample, setting))


def _step_names(setting: Setting, journal: Journal, repeats: Repeats) -> list[str]:
    """Attack steps beyond the first look's; none where a rendering is slow."""
    slow = journal[f"look/{setting.step_key}"]["render_ms"] > 1e3 * repeats.slow_s
    return [] if slow else [f"step/{setting.step_key}/{i}" for i in range(1, setting.steps)]


def _first_alike(setting: Setting, settings: Sequence[Setting]) -> Setting:
    """The first setting that renders the same: the one whose look says how often that is timed."""
    return next(other for other in settings if other.rendering_key == setting.rendering_key)


def _sample_count(setting: Setting, settings: Sequence[Setting], journal: Journal, repeats: Repeats) -> int:
    first_ms = journal[f"look/{_first_alike(setting, settings).step_key}"]["render_ms"]
    return wanted_samples(first_ms, repeats.most, repeats.seconds, repeats.slow_s)


# Guesses for the progress bar alone, from a quiet core without bfloat16: what it says is left soon follows what was
# measured.
def _rendering_seconds(setting: Setting) -> float:
    solver = str(setting.accuracy["solver"])
    if solver == "paper":
        return 20.0 if setting.accuracy.get("sphere_chord_only") else 85.0
    return {"piecewise_linear": 5.0, "plain_sphere_tracing": 0.7}.get(solver, 0.4)


def _window_seconds(setting: Setting) -> float:
    return 4.0 if setting.crop_m is None else 0.3


def _attack_seconds(setting: Setting) -> float:
    return 2.0 * setting.attack_steps * (_rendering_seconds(setting) + _window_seconds(setting))


def _timing_seconds(setting: Setting) -> float:
    once = _rendering_seconds(setting)
    return 0.0 if once >= 5.0 else 1.0 + once / 2


def expected_seconds(settings: Sequence[Setting], cases: int) -> float:
    """What `measure_case` tells in all, about."""
    total = 0.0
    for setting in settings:
        total += _rendering_seconds(setting) * (1 + setting.displaced) + 4 * _window_seconds(setting)
        total += _attack_seconds(setting) + (setting.steps - 1) * (
            _rendering_seconds(setting) + 2 * _window_seconds(setting)
        )
    total += sum(_timing_seconds(s) for s in {s.rendering_key: s for s in settings}.values())
    return cases * total
