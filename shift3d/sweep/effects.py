"""Which effects the scenes of a plan call for, decided once for each scene, vehicle and detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from shift3d.config.catalogue import Catalogue, SceneEntry
from shift3d.config.schema import Config
from shift3d.render.called_for import NEEDS, Choice, DetectorFacts, choose
from shift3d.scenes.facts import EffectSettings

__all__ = ["EffectChoices", "EffectLine", "effect_table"]


@dataclass(frozen=True)
class EffectLine:
    """What was decided about one effect. scenes: names of those for which it was decided so. reason: of the first.

    milliseconds: what a rendering costs more, where that was measured.
    """

    effect: str
    used: bool
    reason: str
    scenes: tuple[str, ...]
    milliseconds: float | None


@dataclass
class EffectChoices:
    """Remembers what was decided: a scene is asked once for all tasks that attack one vehicle in it."""

    _names: dict[tuple[str, ...], tuple[str, ...]] = field(default_factory=dict)
    _lines: dict[tuple[str, bool], tuple[Choice, dict[str, None]]] = field(default_factory=dict)

    def of(self, config: Config, catalogue: Catalogue, vehicle: str) -> Callable[[SceneEntry], tuple[str, ...]]:
        """Scene to names of the effects of its tasks, in the order of the physics.

        The function raises InputError where an effect is forced that the scene has no data for.
        """
        effects, said = config.effects, EffectSettings(**config.effects.said())
        frame, detector = catalogue.frame_of(vehicle), DetectorFacts(config.detector.name)
        key = (vehicle, detector.name, repr(effects.use), repr(said))

        def names_for(entry: SceneEntry) -> tuple[str, ...]:
            if (known := self._names.get((entry.content_hash, *key))) is not None:
                return known
            facts = entry.facts.described(said)
            choices = (
                {choice.effect: choice for choice in choose("auto", facts, frame, detector)} if effects.auto else {}
            )
            choices |= {choice.effect: choice for choice in choose(effects.forced(), facts, frame, detector)}
            for choice in choices.values():
                _, scenes = self._lines.setdefault((choice.effect, choice.used), (choice, {}))
                scenes[entry.name] = None
            names = tuple(effect for effect in NEEDS if effect in choices and choices[effect].used)
            return self._names.setdefault((entry.content_hash, *key), names)

        return names_for

    def lines(self) -> tuple[EffectLine, ...]:
        """What was decided, by effect in the order of the physics."""
        order = {effect: number for number, effect in enumerate(NEEDS)}
        return tuple(
            EffectLine(choice.effect, choice.used, choice.reason, tuple(scenes), choice.milliseconds)
            for (effect, _), (choice, scenes) in sorted(
                self._lines.items(), key=lambda item: (order[item[0][0]], not item[0][1])
            )
        )


def effect_table(lines: tuple[EffectLine, ...], scenes: int) -> str:
    """The table of a plan: effect, scenes that call for it, expected cost, reason; one line where there is none."""
    if not lines:
        return "effects: occlusion alone; no scene calls for more"
    head = ("effect", "scenes", "ms a rendering", "why (of the first scene)")
    rows = [
        (
            line.effect if line.used else f"({line.effect})",
            f"{len(line.scenes)} of {scenes}",
            "not measured" if line.milliseconds is None else f"{line.milliseconds:.1f}",
            line.reason,
        )
        for line in lines
    ]
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(3)]
    text = ["effects beside occlusion; in brackets: left out"]
    text += [
        "  " + "  ".join(f"{row[column]:<{widths[column]}}" for column in range(3)) + f"  {row[3]}"
        for row in [head, *rows]
    ]
    return "\n".join(text)
