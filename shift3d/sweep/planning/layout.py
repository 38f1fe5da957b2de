"""Layout of the tasks of a combination of settings: scenes, transfer scenes, and the effects in them.

A layout is computed once for all combinations with the same inputs: a sweep of many settings over many scenes examines
each scene a few times, not once per task.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from shift3d.errors import InputError
from shift3d.settings import messages
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.schema.config import Config
from shift3d.settings.schema.scenes import FramesConfig
from shift3d.sweep.planning.effect_choices import EffectChoiceCache
from shift3d.sweep.planning.tasks_builder import TasksBuilder
from shift3d.task.spec import TaskSpec, TransferScene

Effects = tuple[str, ...]


@dataclass(frozen=True)
class _Layout:
    """One task per scene, in order.

    place: task scene of each task, as the builder numbers them. kind: of each task, index into kinds: (data set,
    effects, True if settings of effects concern it).
    """

    place: np.ndarray
    kind: np.ndarray
    kinds: tuple[tuple[str, Effects, bool], ...]


@dataclass
class LayoutCache:
    """Cache of layouts while a plan is made. builder: numbers the task scenes. where: for errors."""

    builder: TasksBuilder
    decided: EffectChoiceCache
    where: str
    _known: dict[tuple[object, ...], _Layout] = field(default_factory=dict)

    def tasks_of(self, config: Config, catalogue: Catalogue, spec: TaskSpec) -> tuple[np.ndarray, np.ndarray]:
        """Return the builder's numbers of the template and the task scene of each task of one combination of settings.

        spec: common part of the tasks.
        Raises: InputError: the scene is unknown, the set is empty or too small for the transfers, or a scene lacks the
        data for a forced effect.
        """
        elsewhere = config.attack.search_scenes + config.attack.transfer_scenes
        transfers = elsewhere if config.mode == "shape" else 0
        # The catalogue lives while the plan is made, so its id() identifies its content.
        key = (id(catalogue), config.scene, transfers, spec.detector, repr(config.effects))
        if key not in self._known:
            self._known[key] = self._layout(config, catalogue, transfers)
        layout, overrides = self._known[key], config.effects.overrides()
        grounds = [
            self.builder.template(
                replace(spec, dataset=dataset, effects=effects, effect_settings=overrides if concerned else {})
            )
            for dataset, effects, concerned in layout.kinds
        ]
        return np.array(grounds, dtype=np.int32)[layout.kind], layout.place

    def _layout(self, config: Config, catalogue: Catalogue, transfers: int) -> _Layout:
        own = self._own(config, catalogue)
        others = self._others(own, len(catalogue.scenes), transfers)
        all_scenes = list(dict.fromkeys([*own, *(at for row in others for at in row)]))
        effects = dict(zip(all_scenes, self.decided.of(config, catalogue, all_scenes), strict=True))
        scenes = catalogue.scenes
        elsewhere = {
            at: TransferScene(scenes[at].name, scenes[at].content_hash, effects[at]) for row in others for at in row
        }
        kinds: dict[tuple[str, Effects, bool], int] = {}
        kind, place = np.empty(len(own), dtype=np.int32), np.empty(len(own), dtype=np.int32)
        for row, at in enumerate(own):
            entry, to = scenes[at], tuple(elsewhere[other] for other in others[row])
            concerned = bool(effects[at]) or any(other.effects for other in to)
            kind[row] = kinds.setdefault((entry.dataset, effects[at], concerned), len(kinds))
            place[row] = self.builder.task_scene((entry.name, entry.content_hash, to))
        return _Layout(place, kind, tuple(kinds))

    def _own(self, config: Config, catalogue: Catalogue) -> list[int]:
        """Return the positions of the scenes that the settings select."""
        own = [at for at, entry in enumerate(catalogue.scenes) if config.scene in (None, entry.name)]
        if not own and config.scene is not None:
            names = [entry.name for entry in catalogue.scenes]
            raise messages.choice_error("scene", config.scene, names, f"{self.where}, scene")
        if not own:
            of = config.scenes.root if isinstance(config.scenes, FramesConfig) else config.scenes.kind
            what = f"the scene set {of} is empty"
            raise InputError(what, where=self.where, remedy="Check scenes.count and scenes.names")
        return own

    def _others(self, own: Sequence[int], scenes: int, count: int) -> list[list[int]]:
        """Return, for each scene, the other scenes of its shape: the next ones in the set, cyclically. Consecutive
        tasks share all but one of these scenes, and a worker has them loaded."""
        if count >= scenes:
            what = f"attack.search_scenes and transfer_scenes need {count} scenes, and the set has {scenes - 1} others"
            remedy = f"Give scenes.count={count + 1} or more, or fewer of them"
            raise InputError(what, where=self.where, remedy=remedy)
        return [[(at + step) % scenes for step in range(1, count + 1)] for at in own]
