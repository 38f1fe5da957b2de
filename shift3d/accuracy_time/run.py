"""Interleaved measurement of all settings on a case, resumed from the case's journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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

    def take(name: str, setting: Setting, seconds: float, make: Callable[[Setting], Any]) -> None:
        known = name in journal
        tell(setting.name, 0.0, known)
        if not known:
            journal.put(name, make(setting))
        tell(setting.name, seconds, known)

    for setting in settings:
        seconds = _seconds(setting)
        take(f"look/{setting.step_key}", setting, seconds["look"], instrument.look)
        if setting.displaced:
            take(f"displaced/{setting.displaced_key}", setting, seconds["displaced"], instrument.displaced)
        if setting.attack_steps:
            take(f"attack/{setting.attack_key}", setting, seconds["attack"], instrument.attack)
    more = {s.name: (s, _step_names(s, journal, repeats)) for s in settings}
    for name, number in interleaved_samples({name: len(found) for name, (_, found) in more.items()}):
        setting, found = more[name]
        take(found[number], setting, _seconds(setting)["step"], instrument.step)
    alike: dict[str, Setting] = {}  # first setting of each rendering; its first measurement decides the sample count
    for setting in settings:
        alike.setdefault(setting.rendering_key, setting)
    first_ms = {key: journal[f"look/{setting.step_key}"]["render_ms"] for key, setting in alike.items()}
    counts = {
        key: num_further_timings(ms, repeats.most, repeats.seconds, repeats.slow_s) for key, ms in first_ms.items()
    }
    for key, number in interleaved_samples(counts):
        setting = alike[key]
        take(f"sample/{key}/{number}", setting, _seconds(setting)["samples"] / counts[key], instrument.sample)
    results: dict[str, CaseResult] = {}
    for setting in settings:
        look, key = journal[f"look/{setting.step_key}"], setting.rendering_key
        displaced = journal[f"displaced/{setting.displaced_key}"] if setting.displaced else None
        steps = [look, *(journal[name] for name in more[setting.name][1])]
        samples = [journal[f"sample/{key}/{i}"] for i in range(counts[key])] or [first_ms[key]]
        attack = journal[f"attack/{setting.attack_key}"] if setting.attack_steps else None
        results[setting.name] = CaseResult(look, displaced, tuple(steps), tuple(samples), attack)
    return results


def _step_names(setting: Setting, journal: Journal, repeats: RepeatLimits) -> list[str]:
    """Name the attack steps beyond that of `look`; none for a slow rendering."""
    slow = journal[f"look/{setting.step_key}"]["render_ms"] > 1e3 * repeats.slow_s
    return [] if slow else [f"step/{setting.step_key}/{i}" for i in range(1, setting.steps)]


def _seconds(setting: Setting) -> dict[str, float]:
    """Estimate the time of each measurement on a quiet core without bfloat16, for the progress bar only."""
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
