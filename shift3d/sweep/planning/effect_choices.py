"""Choice of the effects for the scenes of a plan, made once per scene and detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from shift3d.effects.applicability import NEEDS, Choice, choose
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.schema.config import Config
from shift3d.sweep.planning.tasks import distinct_with_indices

Decision = tuple[Choice, tuple[str, ...]]
"""Choice about an effect, and the names of its scenes; the reason is that of the first scene."""


@dataclass
class EffectChoiceCache:
    """Cache of effect choices: scenes that differ only in their names are decided once."""

    _lines: dict[tuple[str, bool], tuple[Choice, dict[str, None]]] = field(default_factory=dict)
    _alike: dict[int, tuple[Catalogue, list[int], list[SceneFacts]]] = field(default_factory=dict)
    _settings: dict[str, None] = field(default_factory=dict)

    def of(self, config: Config, catalogue: Catalogue, scenes: Sequence[int]) -> list[tuple[str, ...]]:
        """Return the names of the effects of tasks in these scenes, in the physical order of `NEEDS`.

        Args: scenes: positions in the catalogue.
        Raises: InputError: a scene lacks the data for a forced effect.
        """
        overrides = EffectSettings(**config.effects.overrides())
        self._settings |= dict.fromkeys(overrides.overrides())
        detector = DetectorFacts(config.detector.name)
        kind, facts = self._kinds(catalogue)
        found: dict[int, tuple[tuple[str, ...], list[dict[str, None]]]] = {}
        names = []
        for at in scenes:
            if kind[at] not in found:
                choices = _choices(config, facts[kind[at]].described(overrides), detector)
                lines = [self._lines.setdefault((c.effect, c.used), (c, {}))[1] for c in choices.values()]
                used = tuple(effect for effect in NEEDS if effect in choices and choices[effect].used)
                found[kind[at]] = used, lines
            effects, lines = found[kind[at]]
            names.append(effects)
            for line in lines:
                line[catalogue.scenes[at].name] = None
        return names

    def _kinds(self, catalogue: Catalogue) -> tuple[list[int], list[SceneFacts]]:
        """Return the index of each scene's facts (without its name), and the distinct facts."""
        if id(catalogue) not in self._alike:
            _, numbers = distinct_with_indices(replace(entry.facts, scene_id="") for entry in catalogue.scenes)
            first = np.unique(numbers, return_index=True)[1]
            # The cache keeps the catalogue alive, so that its id() stays unique.
            self._alike[id(catalogue)] = (catalogue, numbers.tolist(), [catalogue.scenes[at].facts for at in first])
        return self._alike[id(catalogue)][1:]

    def unused(self) -> list[str]:
        """Return a line for each setting about scenes that no effect of any task uses."""
        used = {name for effect, used in self._lines if used for name in NEEDS[effect].settings}
        return [f"effects.{name}: no effect of this sweep uses it" for name in self._settings if name not in used]

    def decisions(self) -> tuple[Decision, ...]:
        """Return the decisions in the physical order of `NEEDS`; twice for an effect that only some scenes use."""
        order = list(NEEDS)
        found = sorted(self._lines.values(), key=lambda line: (order.index(line[0].effect), not line[0].used))
        return tuple((choice, tuple(scenes)) for choice, scenes in found)


def _choices(config: Config, facts: SceneFacts, detector: DetectorFacts) -> dict[str, Choice]:
    """Choose the effects of a scene: automatic ones if the settings ask for them, and forced ones."""
    found = choose("auto", facts, detector) if config.effects.auto else []
    found += choose(config.effects.forced(), facts, detector)
    return {choice.effect: choice for choice in found}


def effect_table(decisions: Sequence[Decision], scenes: int) -> str:
    """Return the plan's table: effect, scenes that need it, expected cost, reason; one line if there are no effects."""
    if not decisions:
        return "effects: occlusion only; no scene needs another"
    head = ("effect", "scenes", "ms a rendering", "reason (in the first scene)")
    rows = [
        (
            choice.effect if choice.used else f"({choice.effect})",
            f"{len(names)} of {scenes}",
            "not measured" if choice.milliseconds is None else f"{max(choice.milliseconds, 0.0):.1f}",
            choice.reason,
        )
        for choice, names in decisions
    ]
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(3)]
    text = ["effects besides occlusion; in brackets: left out"]
    text += [
        "  " + "  ".join(f"{row[column]:<{widths[column]}}" for column in range(3)) + f"  {row[3]}"
        for row in [head, *rows]
    ]
    return "\n".join(text)
