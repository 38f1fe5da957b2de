"""Handmade settings and outcomes, for tests of their processing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from shift3d.accuracy_time.settings import Setting


def setting(name: str, solver: str = "sphere_tracing", **changes: Any) -> Setting:
    """Return a setting whose renderings differ by `solver` and the other entries of `renderer`."""
    renderer = {"solver": solver, **changes.pop("renderer", {})}
    accuracy = {**renderer, "detector": changes.pop("detector", "float32")}
    return Setting(name, changes.pop("method", "presets"), accuracy, **changes)


def outcome(**changes: Any) -> dict[str, Any]:
    """Return a rendering without an error: 100 hits, 80 of them thick, 1,000 beams through the ball."""
    plain: dict[str, Any] = dict.fromkeys(("missed", "missed_thick", "wrong", "false", "unresolved"), 0)
    plain |= {"hits": 100, "thick_hits": 80, "depth_m": [0.0] * 100, "residual_m": 0.0, "evaluations": 2000}
    return plain | {"ball_beams": 1000, "score": 0.9, "true_score": 0.9, **changes}


def look(render_ms: float = 100.0, **changes: Any) -> dict[str, Any]:
    """Return a first look at a rendering without an error."""
    times = {"render_ms": render_ms, "detector_ms": 30.0, "step_ms": render_ms + 50.0}
    return {**times, "cosines": [1.0, 1.0], "norm_ratios": [1.0, 1.0], **outcome(), **changes}


class StoppedError(Exception):
    """A simulated interruption."""


@dataclass
class FakeInstrument:
    """Instrument whose answers depend on the setting and the number of calls, with a count of the calls.

    stop_after: number of calls before an interruption. slow: settings whose rendering takes a minute.
    """

    stop_after: int = 10**9
    slow: frozenset[str] = frozenset()
    calls: list[tuple[str, str]] = field(default_factory=list)
    requested: Counter[tuple[str, str]] = field(default_factory=Counter)

    def _called(self, what: str, name: str) -> int:
        if len(self.calls) == self.stop_after:
            raise StoppedError
        self.calls.append((what, name))
        self.requested[what, name] += 1
        return self.requested[what, name]

    def look(self, setting: Setting) -> dict[str, Any]:
        self._called("look", setting.name)
        render_ms = 60_000.0 if setting.name in self.slow else 100.0 + len(setting.name)
        return look(render_ms, missed=len(setting.name), depth_m=[0.1 / 3.0 * len(setting.name)])

    def step(self, setting: Setting) -> dict[str, Any]:
        self._called("step", setting.name)
        return {"render_ms": 1.0, "detector_ms": 2.0 + len(setting.name), "step_ms": 3.0 + len(setting.name)}

    def displaced(self, setting: Setting) -> dict[str, Any]:
        self._called("displaced", setting.name)
        return outcome(score=0.8, wrong=1)

    def attack(self, setting: Setting) -> dict[str, Any]:
        self._called("attack", setting.name)
        return {"scores": [0.25, 0.5]}

    def sample(self, setting: Setting) -> float:
        self._called("sample", setting.name)
        return 10.0 * len(setting.name) / 3.0
