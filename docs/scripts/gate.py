"""Share of simulated releases that the gate stops, by number of hard objects and noise between two trainings.

``python docs/scripts/gate.py [json=FILE]`` prints and writes figures. A suite has as many controls as hard objects, two
of each per scene. Logits of the scores are normal: -0.5 +- 2 for hard objects, 2 +- 1.2 for controls. json: file for
the numbers, with their commit and command.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.statistics.releases import ReleaseRule, SimulatedRates, stopped_releases
from shift3d.seeding import generator
from shift3d.store.atomic import write_atomic

LOSS = 0.02
OBJECTS = (500, 1000, 2000, 4000)
RELEASES = 200
NOISES = (0.0, 0.05, 0.1, 0.2, 0.4)


def suite(objects: int) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[str]]:
    """Return scores, mask of hard objects, and scenes of a suite with as many controls as hard objects."""
    rng = generator("gate suite", objects)
    logits = np.concatenate((rng.normal(-0.5, 2.0, objects), rng.normal(2.0, 1.2, objects)))
    hard = np.repeat([True, False], objects)
    return 1.0 / (1.0 + np.exp(-logits)), hard, [str(index % objects // 2) for index in range(2 * objects)]


def rates(objects: int, noise: float) -> SimulatedRates:
    """Return the share of simulated releases that the gate's own rule stops."""
    return stopped_releases(*suite(objects), noise, LOSS, ReleaseRule(), RELEASES)


def main() -> int:
    """Print the figures and write them."""
    figures: dict[str, dict[str, object]] = {}
    for noise in NOISES:
        found = {objects: rates(objects, noise) for objects in OBJECTS}
        figures[f"{noise:g}/lost without a loss"] = {"value": found[OBJECTS[-1]].lost, "unit": "share"}
        for objects, rate in found.items():
            for what, value in (("found", rate.found), ("false alarms", rate.false_alarms)):
                figures[f"{noise:g}/{objects} objects/{what}"] = {"value": value, "unit": "share", "n": RELEASES}
    text = json.dumps(figures, indent=1) + "\n"
    for word in sys.argv[1:]:
        write_atomic(Path(word.removeprefix("json=")), text.encode())
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
