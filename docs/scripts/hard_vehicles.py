"""How hard vehicles get that stay vehicles: finished sweeps as a table, numbers and a picture of what was found.

``python docs/scripts/hard_vehicles.py OUT ... [json=FILE] [picture=FILE]`` prints a Markdown table: a line a search and
scoring detector. Every task counts, one without a valid step with its baseline's score. Intervals redraw whole scenes.
json: a file that the numbers are written to, with their commit and command. picture: the adversarial shapes, up to 50
at random, as a PNG.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.intervals import Interval, ratio_interval
from shift3d.analysis.statistics.paired import paired
from shift3d.analysis.variants import Variant, variants
from shift3d.seeding import generator
from shift3d.store.atomic import write_atomic

HEADER = ("search", "scored by", "tasks", "natural", "baseline", "random draws", "search", "of baseline, random draws",
          "of baseline", "less random draws")  # fmt: skip
PANELS, COLUMNS = 50, 10


def lines(variant: Variant) -> tuple[list[str], dict[str, tuple[float | Interval, str]]]:
    """A line of the table, and its numbers by name."""
    rows = dict(list(variant.rows.groupby("method")))
    found, base, drawn = (rows[name] for name in ("adversarial", "baseline", "random_search"))
    natural = int(found["natural"].eq(True).sum())
    means = [float(part["score"].mean()) for part in (base, drawn, found)]
    ratios = [ratio_interval(part, base) for part in (drawn, found)]
    difference = paired(variant.rows, "adversarial", "random_search")
    assert ratios[0] is not None and ratios[1] is not None and difference is not None
    cells = [f"{variant.mode} {variant.search}", variant.scored_by, str(len(found)), f"{natural} of {len(found)}"]
    cells += [f"{mean:.3f}" for mean in means] + [text(one) for one in (*ratios, difference.interval)]
    numbers: dict[str, tuple[float | Interval, str]] = {
        "natural": (natural / len(found), "share"),
        "of_baseline_random_search": (ratios[0], "ratio"),
        "of_baseline": (ratios[1], "ratio"),
        "less_random_search": (difference.interval, "AUC"),
    }
    key = f"{variant.mode}_{variant.search}_scored_by_{variant.scored_by}"
    return cells, {f"{key}_{name}": value for name, value in numbers.items()}


def text(one: Interval) -> str:
    """With its ends, where there are some."""
    return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]" if one.high < float("inf") else f"{one.mean:.2f}"


def kinds(sweep: Sweep) -> Iterator[str]:
    """What each method's shapes are drawn as, in words."""
    for method, rows in sweep.solutions.groupby("method"):
        if method in ("adversarial", "random_search"):
            own = rows["drawn_as"].fillna(rows["vehicle"])
            counts = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in Counter(own).most_common())
            yield f"{method}: {counts}"


def draw(sweeps: list[Sweep], path: Path) -> None:
    """The adversarial shapes of all sweeps, up to `PANELS` at random, each with its score and percentile."""
    import matplotlib.pyplot as plt
    import numpy as np

    from shift3d.analysis.cases.rendered import Loaded
    from shift3d.vehicles.picture import BODY_RGB, shaded

    every = [(sweep, row) for sweep in sweeps for row in _adversarial(sweep)]
    order = sorted(generator("hard vehicles picture").permutation(len(every))[:PANELS])
    figure, panels = plt.subplots(-(-len(order) // COLUMNS), COLUMNS, figsize=(15, 1.5 * -(-len(order) // COLUMNS)))
    loaded = {id(sweep): Loaded(sweep.plan) for sweep in sweeps}
    for panel in np.ravel(panels):
        panel.set_axis_off()
    for panel, index in zip(np.ravel(panels), order):
        sweep, row = every[index]
        (task,) = sweep.plan.tasks.starting_with(row["task_id"])
        mesh = loaded[id(sweep)].mesh(task, row, 129)
        span_m = 6.0 if np.ptp(mesh.vertices[:, 0]) < 6.0 else 8.9
        panel.imshow(shaded(mesh, 0.75, 0.3, 400, 230, span_m, BODY_RGB))
        place = f"{row['score']:.2f}, {row['naturalness_percentile']:.0f} %"
        panel.set_title(f"{row['vehicle'].replace('_', ' ')}\n{place}", fontsize=6)
    figure.savefig(path, dpi=100, bbox_inches="tight")


def _adversarial(sweep: Sweep) -> list[dict[str, Any]]:
    """Rows of solutions with the score that the attacked detector gives, and the shape's percentile."""
    scores = sweep.scores[sweep.scores["scored_by"] == sweep.scores["detector"]]
    judged = scores[["task_id", "method", "score", "naturalness_percentile"]]
    found = sweep.solutions[sweep.solutions["method"] == "adversarial"].merge(judged, on=["task_id", "method"])
    rows: list[dict[str, Any]] = found.to_dict("records")
    return rows


def main() -> int:
    """Print the table; write the numbers and the picture that are asked for."""
    files = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    sweeps = [read_sweep(word) for word in sys.argv[1:] if "=" not in word]
    command = "python docs/scripts/hard_vehicles.py OUT"
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    numbers: dict[str, dict[str, object]] = {}
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for sweep in sweeps:
        for variant in variants(sweep.auc, sweep.scored):
            cells, values = lines(variant)
            print(f"| {' | '.join(cells)} |")
            for name, (value, unit) in values.items():
                mean, ends = (value.mean, [value.low, value.high]) if isinstance(value, Interval) else (value, None)
                rounded = [round(end, 3) for end in ends] if ends else None
                numbers[name] = {"value": round(mean, 3), "unit": unit, "interval": rounded}
                numbers[name] |= {"commit": commit, "command": command}
    print("\n" + "\n".join(line for sweep in sweeps for line in kinds(sweep)))
    if "json" in files:
        write_atomic(Path(files["json"]), (json.dumps(numbers, indent=1) + "\n").encode())
    if "picture" in files:
        draw(sweeps, Path(files["picture"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
