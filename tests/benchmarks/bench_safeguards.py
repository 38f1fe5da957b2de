"""What stability costs: an attack step as it is, and without the safeguards that an ordinary object does not need.

The catalogue of hard cases names each safeguard and how it is taken out. Those on the way of a step that can be taken
out without changing one bit of an ordinary attack are taken out together, and the step is timed with and without them,
in turns. A safeguard that does change an ordinary attack is no mere safeguard: it is how the result is reached.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
from benchmarks.results import Results
from benchmarks.steps import AttackLoops
from benchmarks.timing import Timing
from benchmarks.world import World, open_world

HARD_CASES = Path(__file__).resolve().parents[1] / "hard_cases"
ON_THE_WAY = tuple(f"shift3d.{part}." for part in ("render", "attack", "detectors", "geometry", "sdf"))


@pytest.fixture(scope="module")
def idle(quick: bool) -> tuple[object, ...]:
    """Edits that take out safeguards and leave an attack on a thinned scene as it was, bit for bit."""
    sys.path[:0] = [str(HARD_CASES), str(HARD_CASES.parent)]
    for path in sorted(HARD_CASES.glob("cases_*.py")):
        importlib.import_module(path.stem)
    from catalogue import CASES, Edit, patience, without

    small = open_world(thin=20)
    problem = small.problem(small.twin_scene)

    def found() -> list[tuple[float, ...]]:
        loops = AttackLoops(problem, steps=2)
        loops.run()
        return [(record.loss, record.proposal_score) for mode in loops.modes for record in loops.loops[mode].records]

    plain = found()
    kept: list[Edit] = []
    for case in list(CASES.values())[:: 4 if quick else 1]:
        edits = [edit for edit in case.edits if edit not in kept]
        if not edits or not all(edit.module.startswith(ON_THE_WAY) for edit in case.edits):
            continue
        try:
            with without((*kept, *edits)), patience(8.0):
                same = found() == plain
        except Exception:  # without it not even an ordinary attack works, or it cannot be taken out beside another
            same = False
        if same:
            kept += edits
    return tuple(kept)


def bench_safeguards(bench: Results, world: World, idle: tuple[object, ...], quick: bool) -> None:
    from catalogue import without

    problem = world.problem(world.twin_scene)
    steps = 3 if quick else 7
    guarded, bare = AttackLoops(problem, steps), AttackLoops(problem, steps)
    for _ in range(1 if quick else 4):
        guarded.run()
        with without(idle):  # type: ignore[arg-type]
            bare.run()
    of = "an attack step over the same without the safeguards that change nothing in it"
    for mode in guarded.modes:
        above, below = guarded.loops[mode].step, bare.loops[mode].step
        # The same steps of the same attacks: compared one by one, so that their differing lengths cancel.
        ratios = Timing.of([a / b for a, b in zip(above.samples_ms, below.samples_ms, strict=True)])
        note = f"{above.median:.0f} / {below.median:.0f} ms, {len(idle)} safeguards"
        name = f"safeguards_{mode}_ratio"
        bench.add(name, ratios.median, "ratio", f"{of}, {mode} attack", ratios.low, ratios.high, note)
