"""One setting that is measured, and what of it has to be measured only once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Setting:
    """A row of the frontier before it is measured.

    name, method, knob, knob_name, preset: as in the table, see `store.frontier_table`. accuracy: every setting of the
    renderer as plain values, and "detector", the precision in the search, as
    `settings.catalogue.reading.accuracy_settings` gives them. The others: see
    `settings.accuracy_time.MeasuredSetting`.
    """

    name: str
    method: str
    accuracy: Mapping[str, Any]
    knob: float | None = None
    knob_name: str | None = None
    preset: str | None = None
    crop_m: float | None = 8.0
    warm: Literal["no", "shape", "pose"] = "no"
    gradient: Literal["no", "shape", "pose"] = "no"
    grid: bool = False
    incremental: bool = True
    displaced: bool = True
    steps: int = 1
    attack_steps: int = 0

    @property
    def variable(self) -> Literal["no", "shape", "pose"]:
        """What a rendering is timed ready to take the gradient of; a warm one that of its attack's variable."""
        return self.gradient if self.warm == "no" else self.warm

    @property
    def score_precision(self) -> str:
        """Of the detector that scores; as tasks have it (`task.assets.score_precision`)."""
        return "float64" if self.accuracy["detector"] == "float64" else "float32"

    @property
    def rendering_key(self) -> str:
        """Settings with the same one render the same: they share one measured time, so that none beats another.

        What shapes a gradient alone changes no rendering that prepares none.
        """
        without = {"detector"} if self.variable != "no" else {"detector", "min_n_dot_d"}
        renderer = {name: value for name, value in self.accuracy.items() if name not in without}
        return _digest(renderer, self.warm, self.variable, self.grid)

    @property
    def displaced_key(self) -> str:
        """Settings with the same one see the same displaced shape with the same score."""
        return _digest(self.rendering_key, self.score_precision, self.crop_m is None)

    @property
    def step_key(self) -> str:
        """Settings with the same one take the same attack step."""
        return _digest(self.rendering_key, dict(self.accuracy), self.crop_m, self.incremental)

    @property
    def attack_key(self) -> str:
        """Settings with the same one make the same attacks."""
        return _digest(dict(self.accuracy), self.attack_steps)


def _digest(*parts: object) -> str:
    text = json.dumps(parts, sort_keys=True, allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
