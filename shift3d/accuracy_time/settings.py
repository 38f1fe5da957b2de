"""Measured setting, with keys for measurements that several settings share."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Setting:
    """Setting of one row of the frontier.

    name, method, knob, knob_name, preset: columns of the table, see `store.frontier_table`. accuracy: every renderer
    setting as plain values and "detector", the precision in the search, from
    `settings.catalogue.reading.accuracy_settings`. Other fields: see `settings.accuracy_time.FrontierSettingConfig`.
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
        """Variable whose gradient the timed rendering prepares; of a warm rendering, the variable of its attack."""
        return self.gradient if self.warm == "no" else self.warm

    @property
    def score_precision(self) -> str:
        """Precision of the scoring detector, as in tasks (`task.assets.score_precision`)."""
        return "float64" if self.accuracy["detector"] == "float64" else "float32"

    @property
    def rendering_key(self) -> str:
        """Key of the rendering. Settings with equal keys render the same and share one time, so that they tie.

        The key leaves out settings that affect the gradient only if the rendering prepares no gradient.
        """
        without = {"detector"} if self.variable != "no" else {"detector", "min_n_dot_d"}
        renderer = {name: value for name, value in self.accuracy.items() if name not in without}
        return _digest(renderer, self.warm, self.variable, self.grid)

    @property
    def displaced_key(self) -> str:
        """Key of the displaced shape: settings with equal keys see the same shape with the same score."""
        return _digest(self.rendering_key, self.score_precision, self.crop_m is None)

    @property
    def step_key(self) -> str:
        """Key of the attack step: settings with equal keys take the same step."""
        return _digest(self.rendering_key, dict(self.accuracy), self.crop_m, self.incremental)

    @property
    def attack_key(self) -> str:
        """Key of the attacks: settings with equal keys run the same attacks."""
        return _digest(dict(self.accuracy), self.attack_steps)


def _digest(*parts: object) -> str:
    text = json.dumps(parts, sort_keys=True, allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
