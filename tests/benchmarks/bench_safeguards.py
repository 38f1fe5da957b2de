"""What stability costs: an attack step as it is, and without the safeguards that an ordinary object does not need.

The catalogue of hard cases names each safeguard and how it is taken out. Those on the way of a step that can be taken
out without changing one bit of an ordinary attack are taken out together, and the step is timed with and without them,
in turns. A safeguard that does change an ordinary attack is no mere safeguard: it is how the result is reached. That is
asked first on a thinned scene, one by one, and then, all together, on the scene that is timed: on 6,000 beams no
followed hit may be lost where on 120,000 one is, and what finds it again is then no idle safeguard.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from benchmarks.results import Results
from benchmarks.steps import AttackLoops
from benchmarks.timing import Timing
from benchmarks.world import World, open_world

from shift3d.attack.problem import AttackProblem

HARD_CASES = Path(__file__).resolve().parents[1] / "hard_cases"
sys.path[:0] = [str(HARD_CASES), str(HARD_CASES.parent)]
from catalogue import CASES, Edit, patience, without  # noqa: E402

ON_THE_WAY = tuple(f"shift3d.{part}." for part in ("render", "attack", "detectors", "geometry", "sdf"))


def _asks(problem: AttackProblem, steps: int, seconds: float) -> Callable[[list[Edit]], bool]:
    """Whether attacks on a problem stay as they are, bit for bit, when safeguards are taken out."""

    def found() -> list[tuple[float, ...]]:
        loops = AttackLoops(problem, steps=steps)
        loops.run()
        return [(record.loss, record.proposal_score) for mode in loops.modes for record in loops.loops[mode].records]

    def unchanged(edits: list[Edit]) -> bool:
        try:
            with without(tuple(edits)), patience(seconds):
                return found() == plain
        except Exception:  # without it not even an ordinary attack works, or it cannot be taken out beside another
            return False

    plain = found()
    return unchanged


@pytest.fixture(scope="module")
def idle(quick: bool, world: World) -> tuple[Edit, ...]:
    """Edits that take out safeguards and leave attacks as they were, bit for bit, on the scene that is timed too."""
    for path in sorted(HARD_CASES.glob("cases_*.py")):
        importlib.import_module(path.stem)
    small = open_world(thin=20)
    unchanged = _asks(small.problem(small.twin_scene), steps=2, seconds=8.0)
    kept: list[Edit] = []
    for case in list(CASES.values())[:: 4 if quick else 1]:
        edits = [edit for edit in case.edits if edit not in kept]
        if edits and all(edit.module.startswith(ON_THE_WAY) for edit in case.edits) and unchanged(edits):
            kept += edits
    together = _together(kept, unchanged)
    on_scene = _asks(world.problem(world.twin_scene), steps=3 if quick else 7, seconds=120.0)
    return tuple(_together(together, on_scene))


def _together(edits: list[Edit], unchanged: Callable[[list[Edit]], bool]) -> list[Edit]:
    """Those that leave an attack as it was when they are taken out all at once, too: two may guard one thing."""
    if not edits or unchanged(edits):
        return edits
    half = len(edits) // 2
    if not half:
        return []
    parts = [_together(part, unchanged) for part in (edits[:half], edits[half:])]
    both = parts[0] + parts[1]
    return both if unchanged(both) else max(parts, key=len)


def bench_safeguards(bench: Results, world: World, idle: tuple[Edit, ...], quick: bool) -> None:
    problem = world.problem(world.twin_scene)
    steps = 3 if quick else 7
    guarded, bare = AttackLoops(problem, steps), AttackLoops(problem, steps)
    for _ in range(1 if quick else 4):
        guarded.run()
        with without(idle):
            bare.run()
    of = "an attack step over the same without the safeguards that change nothing in it"
    for mode in guarded.modes:
        above, below = guarded.loops[mode].step, bare.loops[mode].step
        # The same steps of the same attacks: compared one by one, so that their differing lengths cancel.
        ratios = Timing.of([a / b for a, b in zip(above.samples_ms, below.samples_ms, strict=True)])
        note = f"{above.median:.0f} / {below.median:.0f} ms, {len(idle)} safeguards"
        name = f"safeguards_{mode}_ratio"
        bench.add(name, ratios.median, "ratio", f"{of}, {mode} attack", ratios.low, ratios.high, note)
