"""How often the gate stops simulated releases, by the number of hard objects and the noise between two trainings.

``python docs/scripts/gate.py [json=FILE]`` prints a Markdown table. A suite is hard objects and as many controls, two
of each a scene; logits of the scores are normal, -0.5 +- 2 for hard objects and 2 +- 1.2 for controls. json: a file
that the numbers are written to, with their commit and command.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.statistics.releases import Rates, Rule, stopped_releases
from shift3d.seeding import generator
from shift3d.store.atomic import write_atomic

LOSS = 0.02
OBJECTS = (500, 1000, 2000, 4000)
NOISES = (0.0, 0.05, 0.1, 0.2, 0.4)


def suite(objects: int) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[str]]:
    """Scores, hard objects, and scenes of as many hard objects and as many controls."""
    rng = generator("gate suite", objects)
    logits = np.concatenate((rng.normal(-0.5, 2.0, objects), rng.normal(2.0, 1.2, objects)))
    hard = np.repeat([True, False], objects)
    return 1.0 / (1.0 + np.exp(-logits)), hard, [str(index % objects // 2) for index in range(2 * objects)]


def rates(objects: int, noise: float) -> Rates:
    """Of 200 releases with the gate's own rule."""
    return stopped_releases(*suite(objects), noise, LOSS, Rule())


def main() -> int:
    """Print the table."""
    command = " ".join(["python docs/scripts/gate.py", *sys.argv[1:]])
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    numbers: dict[str, dict[str, object]] = {}
    names = [f"{objects:,} hard objects" for objects in OBJECTS]
    print(f"| noise of the logits | lost without a loss | {' | '.join(names)} |\n|---|---|{'---|' * len(names)}")
    for noise in NOISES:
        found = [rates(objects, noise) for objects in OBJECTS]
        cells = [f"{rate.found:.1%} / {rate.false_alarms:.1%}" for rate in found]
        print(f"| {noise:g} | {found[-1].lost:.1%} | {' | '.join(cells)} |", flush=True)
        for objects, rate in zip(OBJECTS, found, strict=True):
            for name, value in (("found", rate.found), ("false_alarms", rate.false_alarms)):
                key = f"{name}_{objects}_objects_noise_{noise:g}"
                numbers[key] = {"value": value, "unit": "share", "interval": None, "commit": commit, "command": command}
    for word in sys.argv[1:]:
        write_atomic(Path(word.removeprefix("json=")), (json.dumps(numbers, indent=1) + "\n").encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
