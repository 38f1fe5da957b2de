"""Names of the methods whose objects a task scores: the single list of methods."""

from __future__ import annotations

__all__ = ["METHODS", "METHODS_OF_MODE"]

METHODS = {
    "baseline": "baseline",
    "random": "random",
    "random_budget": "best of random draws",
    "edited": "edited",
    "adversarial_noise": "adversarial + noise",
    "adversarial": "adversarial",
}
"""Method name to its label in reports, in the order of the paper's tables."""

METHODS_OF_MODE = {
    "shape": tuple(METHODS),
    "pose": tuple(name for name in METHODS if name not in ("edited", "adversarial_noise")),
    "shape_pose": tuple(METHODS),
}
"""Attack mode to the methods that a task of this mode may score."""
