"""Selection of the effects of a scene. An effect's module is imported only if the scene has the data for the effect."""

from __future__ import annotations

import functools
import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.errors import InputError
from shift3d.scenes.facts import DetectorFacts, SceneFacts

if TYPE_CHECKING:
    from shift3d.effects.base import Effect

MEASURED_IMPACT = Path(__file__).resolve().parent / "measured" / "effects.json"
"""File of the measured impact of each effect; the sweep `sweeps/effects.yaml` measures it."""
IMPACT_BOUND = 0.01
"""`auto` leaves out an effect if its mean change of a score lies below this bound with 95 % confidence. Our choice:
half of a score's permitted difference from its reference; two presets may differ in AUC by as much."""


@dataclass(frozen=True)
class DataRequirement:
    """Data that an effect needs from a scene. lacking: message if the data are missing; remedy: way to supply them.
    settings: fields of `EffectSettings` that the effect reads. needs_reflectance_reader: the effect applies only to
    detectors that read more than coordinates."""

    present: Callable[[SceneFacts], bool]
    lacking: str
    remedy: str = "Use scenes that carry it, or leave the effect out"
    settings: tuple[str, ...] = ()
    needs_reflectance_reader: bool = False


_POWER = ("limit_range_m", "power_spread")
_MOVING = "neither firing times with a velocity of the sensor, nor with a speed of the object"

NEEDS: Mapping[str, DataRequirement] = {
    # In the order in which the effects act.
    "origins": DataRequirement(lambda scene: scene.origins > 1, "all beams start in one place"),
    "no_return_beams": DataRequirement(
        lambda scene: scene.no_return_beams > 0, "it does not know its beams without a return"
    ),
    "rolling_shutter": DataRequirement(
        lambda scene: scene.scan_s > 0.0 and (scene.object_speed_m_s != 0.0 or _ego_moves(scene)),
        _MOVING,
        "Use scenes with firing times; give effects.object_speed_m_s",
        ("object_speed_m_s", "range_noise_m"),
    ),
    "divergence": DataRequirement(
        lambda scene: scene.sensor.divergence_rad is not None,
        "it states no divergence of its beams",
        "Give effects.divergence_rad",
        ("divergence_rad",),
    ),
    "second_returns": DataRequirement(
        lambda scene: scene.returns > 1 and scene.has_pixels, "its points carry no return numbers and pixels"
    ),
    "reflectance": DataRequirement(
        lambda scene: scene.has_reflectance, "its points carry no reflectance", needs_reflectance_reader=True
    ),
    "wet_ground": DataRequirement(
        lambda scene: scene.conditions.rain_mm_h > 0.0 and scene.sensor.limit_range_m is not None,
        "it has no rain, or its sensor's limit is unknown",
        "Give effects.rain_mm_h and effects.limit_range_m",
        ("rain_mm_h", *_POWER),
    ),
    "fog": DataRequirement(
        lambda scene: scene.conditions.visibility_m != float("inf"),
        "its visibility is unlimited",
        "Give effects.visibility_m",
        ("visibility_m", *_POWER),
    ),
    "rain": DataRequirement(
        lambda scene: scene.conditions.rain_mm_h > 0.0,
        "it has no rain",
        "Give effects.rain_mm_h",
        ("rain_mm_h", "divergence_rad", *_POWER),
    ),
    "snow": DataRequirement(
        lambda scene: scene.conditions.snow_mm_h > 0.0,
        "it has no snow",
        "Give effects.snow_mm_h",
        ("snow_mm_h", "divergence_rad", *_POWER),
    ),
    "ray_drop": DataRequirement(
        lambda scene: scene.sensor.limit_range_m is not None,
        "its sensor's limit is unknown",
        "Give effects.limit_range_m",
        _POWER,
    ),
    "range_noise": DataRequirement(
        lambda scene: scene.sensor.range_noise_m is not None,
        "it states no range noise",
        "Give effects.range_noise_m",
        ("range_noise_m",),
    ),
}
"""All effects by name, in the order of the physics, each with the data that it needs."""
_WEATHER = ("wet_ground", "fog", "rain", "snow")


def _ego_moves(scene: SceneFacts) -> bool:
    """True if the points contain the sensor's motion. Origins of compensated points follow the sensor instead."""
    return not scene.conditions.motion_compensated and any(scene.conditions.ego_velocity_m_s or ())


@dataclass(frozen=True)
class MeasuredImpact:
    """Measured impact of an effect. score_change: mean |change| of a score; low, high: its 95 % interval; milliseconds:
    extra time of a rendering with the effect."""

    score_change: float
    low: float
    high: float
    milliseconds: float

    @property
    def matters(self) -> bool:
        """True unless the whole 95 % interval of the change lies below the bound."""
        return not self.high < IMPACT_BOUND


@dataclass(frozen=True)
class Choice:
    """Decision about one effect for one scene, with its reason."""

    effect: str
    used: bool
    reason: str
    milliseconds: float | None = None


def choose(wanted: str | Sequence[str], scene: SceneFacts, detector: DetectorFacts) -> list[Choice]:
    """Choose the effects of a scene, in the order of `NEEDS`. The list omits effects that the scene has no data for.

    Args:
        wanted: "auto", "none", or names. Named effects are used even if the scene does not call for them.

    Raises InputError: an unknown name, or an effect that the scene has no data for.
    """
    if wanted == "auto":
        return _applicable(scene, detector)
    if isinstance(wanted, str):
        wanted = () if wanted == "none" else (wanted,)
    for name in wanted:
        if not need_of(name).present(scene):
            what = f"scene {scene.scene_id} has no data for {name}: {NEEDS[name].lacking}"
            raise InputError(what, "effects", NEEDS[name].remedy)
    impacts = measured_impact()
    return [
        Choice(name, True, "requested", impacts[name].milliseconds if name in impacts else None)
        for name in NEEDS
        if name in wanted
    ]


def need_of(name: str) -> DataRequirement:
    """Return the data that an effect needs. Raises InputError: an unknown name."""
    if name not in NEEDS:
        raise InputError(f"unknown effect {name!r}", "effects", f"Choose from auto, none, {', '.join(NEEDS)}")
    return NEEDS[name]


def _applicable(scene: SceneFacts, detector: DetectorFacts) -> list[Choice]:
    choices = []
    for name, need in NEEDS.items():
        if not need.present(scene) or (need.needs_reflectance_reader and not detector.reads_reflectance):
            continue
        reason = effect_named(name).applicability(scene, detector)
        if reason is None:
            continue
        impact = measured_impact().get(name)
        used = impact is None or impact.matters
        if not used:
            assert impact is not None
            reason = f"left out: {reason}, but it moves scores by {impact.score_change:.3f} (at most {impact.high:.3f})"
        choices.append(Choice(name, used, reason, None if impact is None else impact.milliseconds))
    return choices


def effect_named(name: str) -> Effect:
    """Return the effect of a name in `NEEDS`. Imports the effect's module."""
    effect: Effect = importlib.import_module(f"shift3d.effects.{'weather.' if name in _WEATHER else ''}{name}").EFFECT
    return effect


@functools.cache
def measured_impact() -> dict[str, MeasuredImpact]:
    """Load the measured impacts by name of the effect. Effects without a measurement are missing."""
    if not MEASURED_IMPACT.is_file():
        return {}
    values: dict[str, Any] = json.loads(MEASURED_IMPACT.read_text(encoding="utf-8"))["effects"]
    keys = ("score_change", "low", "high", "milliseconds")
    return {name: MeasuredImpact(*(float(row[key]) for key in keys)) for name, row in values.items()}
