"""The methods whose objects a task scores: the one list of them."""

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
"""By name, in the order of the paper's tables: what a reader is told."""

METHODS_OF_MODE = {
    "shape": tuple(METHODS),
    "pose": tuple(name for name in METHODS if name not in ("edited", "adversarial_noise")),
    "shape_pose": tuple(METHODS),
}
"""By what is attacked: the methods that a task may score."""
