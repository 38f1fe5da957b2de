"""Picture of the adversarial shapes of finished sweeps, up to 50 at random.

``python docs/scripts/hard_vehicles.py PICTURE OUT ...``: PICTURE is a PNG, each OUT the folder of a sweep. Above each
shape: its original vehicle, the score before and after, and its percentile of naturalness.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.seeding import generator

PANELS, COLUMNS = 50, 10


def draw(sweeps: list[Sweep], path: Path) -> None:
    """Draw the picture."""
    import matplotlib.pyplot as plt
    import numpy as np

    from shift3d.analysis.cases.rendered import PageCache
    from shift3d.vehicles.picture import BODY_RGB, shaded

    every = [(sweep, PageCache(sweep.plan), row) for sweep in sweeps for row in found(sweep)]
    order = sorted(generator("hard vehicles picture").permutation(len(every))[:PANELS])
    lines = -(-len(order) // COLUMNS)
    figure, axes = plt.subplots(lines, COLUMNS, figsize=(15, 1.3 * lines))
    for panel in np.ravel(axes):
        panel.set_axis_off()
    for panel, index in zip(np.ravel(axes), order):
        sweep, loaded, row = every[index]
        (task,) = sweep.plan.tasks.starting_with(row["task_id"])
        mesh = loaded.mesh(task, row, 129)
        span_m = 6.0 if np.ptp(mesh.vertices[:, 0]) < 6.0 else 8.9
        panel.imshow(shaded(mesh, 0.75, 0.3, 400, 230, span_m, BODY_RGB))
        scores = f"{row['baseline']:.2f} to {row['score']:.2f}, {row['naturalness_percentile']:.0f} %"
        panel.set_title(f"{row['vehicle'].replace('_', ' ')}\n{scores}", fontsize=6)
    figure.savefig(path, dpi=100, bbox_inches="tight")


def found(sweep: Sweep) -> Iterator[dict[str, Any]]:
    """Yield adversarial rows of the solutions, with the attacked detector's scores of them and of their baselines."""
    scores = sweep.scores[sweep.scores["scored_by"] == sweep.scores["detector"]].set_index(["task_id", "method"])
    for row in sweep.solutions[sweep.solutions["method"] == "adversarial"].to_dict("records"):
        own = scores.loc[(row["task_id"], "adversarial")]
        before = scores.loc[(row["task_id"], "baseline"), "score"]
        yield row | {"baseline": before, **own[["score", "naturalness_percentile"]].to_dict()}


if __name__ == "__main__":
    draw([read_sweep(word) for word in sys.argv[2:]], Path(sys.argv[1]))
