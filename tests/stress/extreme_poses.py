"""Random extreme poses and codes through the real decoder: NaN, hangs, and unresolved beams with their reason.

    python tests/stress/extreme_poses.py --count 10000 --workers 2 --out extreme_poses.json

A case follows from its number alone (`extreme_cases`). Each renders some 160 beams with the gradient of pose and code,
every third case once more from the result (warm). The rendering is then checked against independent evaluations: the
decoder as published, in float64, at places computed without the renderer's code.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import signal
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from extreme_cases import SETTINGS, Case, along_beam, decoders, distance_m, make_case
from torch import Tensor

from shift3d.render import Beams, render
from shift3d.render.beams import FirstHits
from shift3d.render.field.object_field import ObjectField
from shift3d.render.rendering import Rendering
from shift3d.render.solvers import search, sphere_tracing

PATIENCE_S = 20.0
_STEP = np.array([0.01, 0.0, 0.005, 0.001, 0.0, -0.001])
"""Change of a pose that an attack may make in one step: x, y, z in metres, yaw, pitch, roll in radians."""
_SPACING_M = 0.02
_DEEP_M = 0.01
"""A beam that is deeper than this inside the object at a sample does not graze it."""


class HungError(Exception):
    """A case took more than PATIENCE_S of processor time: other work on the machine does not count."""


@dataclass
class Outcome:
    """Counts of one case.

    not_finite: NaN and infinities by place. unresolved: beams by reason. from_inside: hits of a sensor inside the
    object. off_surface: hits that are not on the surface. untold: hits on the surface, but farther from it than the
    tolerance, after a last step that was not evaluated. worst_residual_m: of all hits. looked_along: beams whose first
    crossing was searched with samples; passed: those of them whose range is behind a sample deep inside.
    """

    number: int
    settings: str = ""
    hits: int = 0
    not_finite: Counter[str] = field(default_factory=Counter)
    unresolved: Counter[str] = field(default_factory=Counter)
    from_inside: int = 0
    off_surface: int = 0
    untold: int = 0
    worst_residual_m: float = 0.0
    looked_along: int = 0
    passed: int = 0
    hung: bool = False
    error: str = ""
    seconds: float = 0.0

    @property
    def sound(self) -> bool:
        """True if the case has no error. A passed surface is an inaccuracy, which is counted separately."""
        wrong = self.not_finite.total() or self.from_inside or self.off_surface
        return not (wrong or self.hung or self.error or self.unresolved["unexplained"])


def run_case(number: int) -> Outcome:
    """Render one case and check it; ends within PATIENCE_S of processor time."""

    def ring(signum: int, frame: FrameType | None) -> None:
        raise HungError

    outcome, start = Outcome(number), time.process_time()
    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
    try:
        case = make_case(number)
        outcome.settings = case.settings
        _judge(case, outcome)
    except HungError:
        outcome.hung = True
    except Exception as error:
        outcome.error = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    outcome.seconds = time.process_time() - start
    return outcome


def _judge(case: Case, outcome: Outcome) -> None:
    beams = Beams.from_arrays(case.points, np.zeros(3))
    first = _draw(case, beams, None, outcome)
    if case.number % 3 == 0:
        there = replace(case, theta=case.theta + _STEP)
        _draw(there, beams, first, outcome)


def _draw(case: Case, beams: Beams, earlier: Rendering | None, outcome: Outcome) -> Rendering:
    """Render once with the gradient and check the result."""
    settings = SETTINGS[case.settings]
    code = torch.from_numpy(case.code).to(settings.dtype).requires_grad_()
    theta = torch.from_numpy(case.theta).requires_grad_()
    sdf = decoders()[settings.dtype == torch.float64].field(code)
    drawn = render(beams, sdf, theta, case.frame, settings, None if earlier is None else earlier.warm)
    _count_not_finite(drawn, code, theta, outcome)
    _judge_hits(case, drawn, outcome)
    _look_along(case, drawn, outcome)
    if drawn.unresolved_beams:
        _explain(case, beams, earlier, drawn.unresolved_beams, outcome)
    return drawn


def _count_not_finite(drawn: Rendering, code: Tensor, theta: Tensor, outcome: Outcome) -> None:
    """Count NaN and infinities at rows with finite input, in the ranges, and in both gradients."""
    points = drawn.points[:-2]  # the last two rows are NaN and infinity in the input, and are in no loss
    parts = {"points": points, "ranges": drawn.range_m, "residual": torch.tensor(drawn.max_residual_m)}
    if points.requires_grad:
        points.sin().sum().backward()
        parts |= {"code gradient": code.grad, "pose gradient": theta.grad}
    for name, part in parts.items():
        if part is None:
            outcome.not_finite[f"no {name}"] += 1
        elif not bool(torch.isfinite(part).all()):
            outcome.not_finite[name] += int((~torch.isfinite(part)).sum())


def _judge_hits(case: Case, drawn: Rendering, outcome: Outcome) -> None:
    """Check that hits are on the surface, and that none is seen from inside the object."""
    hit = drawn.hit_mask.numpy()
    outcome.hits += int(hit.sum())
    if not hit.any():
        return
    g = np.abs(distance_m(case, drawn.points.detach().numpy()[hit]))
    settings = SETTINGS[case.settings]
    reachable_m = settings.reachable_residual_m(case.frame.scale_m)
    # The root's tolerance, and the error of its dtype. The last secant step is not evaluated again: from up to
    # final_newton_m away it may end on another linear piece, off by that length times the change of slope.
    bound_m = settings.tolerance_m + reachable_m
    outcome.worst_residual_m = max(outcome.worst_residual_m, float(g.max()))
    outcome.untold += int(((g > bound_m) & (g <= bound_m + settings.final_newton_m)).sum())
    outcome.off_surface += int((g > bound_m + settings.final_newton_m).sum())
    if float(distance_m(case, np.zeros((1, 3)))[0]) < -reachable_m:
        outcome.from_inside += int(hit.sum())


def _look_along(case: Case, drawn: Rendering, outcome: Outcome) -> None:
    """Check if one beam's range is behind a place that is clearly inside the object, unless it starts inside."""
    row = case.number % 80  # of the rows about the object
    k, g = along_beam(case, row, _SPACING_M)
    if len(k) == 0 or g[0] < 0 or float(distance_m(case, np.zeros((1, 3)))[0]) < 0:
        return
    outcome.looked_along += 1
    deep = k[g < -_DEEP_M]
    outcome.passed += bool(len(deep) and float(drawn.range_m[row]) > deep[0] + 1e-9)


def _explain(case: Case, beams: Beams, earlier: Rendering | None, count: int, outcome: Outcome) -> None:
    """Count the reasons why beams are unresolved, each derived from the field along the beam."""
    hits = _hits_again(case, beams, earlier)
    rows = hits.unresolved.tolist()
    outcome.unresolved["unexplained"] += abs(count - len(rows))
    reachable_m = SETTINGS[case.settings].reachable_residual_m(case.frame.scale_m)
    if float(distance_m(case, np.zeros((1, 3)))[0]) < reachable_m:
        outcome.unresolved["sensor inside the object"] += len(rows)
    else:
        outcome.unresolved.update(_reason(case, row) for row in rows)


def _hits_again(case: Case, beams: Beams, earlier: Rendering | None) -> FirstHits:
    """Compute the rendering's first hits again: a rendering counts its unresolved beams and does not name them."""
    settings = SETTINGS[case.settings]
    sdf = decoders()[settings.dtype == torch.float64].field(torch.from_numpy(case.code).to(settings.dtype))
    metric = ObjectField.of(sdf, case.frame, settings.dtype, settings.batch)
    theta, size = torch.from_numpy(case.theta), torch.tensor(case.frame.size_m, dtype=torch.float64)
    with torch.no_grad():
        if settings.solver == "plain_sphere_tracing":
            return sphere_tracing.first_hits(beams, metric, theta, size, settings)
        warm = None if earlier is None else earlier.warm
        return search.first_hits(beams, metric, theta, size, settings, warm)[0]


def _reason(case: Case, row: int) -> str:
    for spacing_m in (_SPACING_M, _SPACING_M / 8):  # the chord may be a short one
        g = along_beam(case, row, spacing_m)[1]
        if not np.isfinite(g).all():
            return "field not finite"
        if (g < 0).any():
            return "crossing that did not settle"
    return "unexplained"


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return totals over cases, the numbers of cases that passed a surface, and all data of unsound ones."""
    ordered = sorted(outcomes, key=lambda outcome: outcome.number)
    seconds = np.array([outcome.seconds for outcome in ordered])

    def total(name: str) -> int:
        return sum(int(bool(v) if isinstance(v, str) else v) for v in (getattr(o, name) for o in ordered))

    return {
        "cases": len(ordered),
        "sound": total("sound"),
        "hung": total("hung"),
        "errors": total("error"),
        "not_finite": dict(sum((o.not_finite for o in ordered), Counter())),
        "unresolved": dict(sum((o.unresolved for o in ordered), Counter())),
        "hits": total("hits"),
        "hits_off_the_surface": total("off_surface"),
        "hits_seen_from_inside": total("from_inside"),
        "hits_beyond_the_tolerance": total("untold"),
        "worst_residual_m": {
            name: max(o.worst_residual_m for o in ordered if o.settings == name)
            for name in sorted({o.settings for o in ordered})
        },
        "beams_looked_along": total("looked_along"),
        "beams_that_passed_a_surface": total("passed"),
        "cases_that_passed_a_surface": [outcome.number for outcome in ordered if outcome.passed],
        "seconds_a_case": {"median": float(np.median(seconds)), "max": float(seconds.max())},
        "not_sound": [asdict(outcome) for outcome in ordered if not outcome.sound],
    }


def _one_thread() -> None:
    torch.set_num_threads(1)


def run(numbers: range, workers: int) -> list[Outcome]:
    """Run all cases in any order, with the remaining time on stderr."""
    outcomes: list[Outcome] = []
    start = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(workers, _one_thread) as pool:
        for outcome in pool.imap_unordered(run_case, numbers, chunksize=4):
            outcomes.append(outcome)
            if len(outcomes) % 20 == 0 or len(outcomes) == len(numbers):
                left_s = (time.monotonic() - start) / len(outcomes) * (len(numbers) - len(outcomes))
                bad = sum(not outcome.sound for outcome in outcomes)
                line = f"{len(outcomes)}/{len(numbers)}, {bad} not sound, {math.ceil(left_s)} s left"
                print(f"\r{line}   ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return outcomes


def main() -> int:
    """Run the cases and write the totals. Returns 1 if any case is not sound."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    totals = summary(run(range(arguments.first, arguments.first + arguments.count), arguments.workers))
    text = json.dumps(totals, indent=1) + "\n"
    if arguments.out is not None:
        arguments.out.write_text(text)
    print(text, end="")
    return 0 if totals["sound"] == totals["cases"] else 1


if __name__ == "__main__":
    sys.exit(main())
