"""Hits that the renderer loses in attacks at every step, against `reference` at the same code and pose.

``python docs/scripts/recorded_attacks.py [workers=N] [json=FILE] [of=TEXT] [SETTING=VALUE ...]``

The attacks are the tasks of the default sweep in one street of split `val`, 40 steps, lambda 1; settings change it. The
script checks the attack's own renderings, each warm from the step before. A hit is lost when it is missed or more than
1 cm off. Every tenth step the script also compares the loss's gradient, with the float32 detector: once as it is, and
once with the gradient at `reference`'s points propagated back through both renderings, so that only the renderers
differ. json: file for the figures. of: prefix for the names of attacks. workers: number of processes.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from shift3d.accuracy_time.errors import THICK_CHORD_M, chord_lengths
from shift3d.accuracy_time.gradient import attack_step, cosine
from shift3d.attack.objective import ATTACK_RADIUS_M
from shift3d.attack.problem import AttackProblem
from shift3d.placement.sampling import NoPlacement
from shift3d.processor import configure_runtime
from shift3d.render.culling import object_rays
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import REFERENCE
from shift3d.render.solvers.search import WarmStart
from shift3d.store.atomic import write_atomic
from shift3d.sweep.planning.plan import Plan
from shift3d.task.assets import load_assets
from shift3d.task.differences import WRONG_SURFACE_M
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.searching import search_task

SWEEP = ("vehicle=coupe,sports_car,suv,convertible,beach_wagon", "mode=shape,pose", "attack.lambda=1",
         "scenes.split=val", "scenes.count=1", "naturalness=none", "effects=none")  # fmt: skip
GRADIENT_EVERY = 10

See = Callable[[Tensor, Tensor, WarmStart | None, Rendering], None]


@dataclass(frozen=True)
class Watched(AttackProblem):
    """Attack problem that reports every rendering with its code (d,), its pose (6,) and its warm start."""

    see: See | None = None

    def insert(self, code: Tensor, theta: Tensor, warm: WarmStart | None = None) -> Rendering:
        """See `AttackProblem.insert`."""
        rendering = super().insert(code, theta, warm)
        if self.see is not None:
            self.see(code.detach(), theta.detach(), warm, rendering)
        return rendering


@dataclass
class Found:
    """Counts of an attack: hits of all steps, lost hits, lost hits with chords of 2 cm or more, and other errors."""

    name: str
    hits: int = 0
    lost: int = 0
    lost_thick: int = 0
    false: int = 0
    depth_m: tuple[float, ...] = ()
    cosines: tuple[float, ...] = ()
    renderer_cosines: tuple[float, ...] = ()

    def __add__(self, other: Found) -> Found:
        """Return the sum of both counts, under the name of this one."""
        parts = {part.name: getattr(self, part.name) + getattr(other, part.name) for part in fields(self)[1:]}
        return Found(self.name, **parts)

    def hold(self, true: AttackProblem, code: Tensor, theta: Tensor, rendering: Rendering) -> None:
        """Count errors of a rendering. true: problem of the true one. code: (d,) in `true`'s dtype. theta: (6,)."""
        truth = render(true.beams, true.field_of(code), theta, true.vehicle, true.settings)
        depth_m = (rendering.range_m - truth.range_m).abs()
        lost = truth.hit_mask & ~(rendering.hit_mask & (depth_m <= WRONG_SURFACE_M))
        index = torch.nonzero(lost).squeeze(1)
        chord_m = chord_lengths(true.metric(code), object_rays(true.beams, index, theta), truth.range_m[index])
        self.hits += int(truth.hit_mask.sum())
        self.lost += len(index)
        self.lost_thick += int((chord_m >= THICK_CHORD_M).sum())
        self.false += int((rendering.hit_mask & ~truth.hit_mask).sum())
        self.depth_m += tuple(depth_m[truth.hit_mask & ~lost].tolist())


def attacked(plan: Plan, index: int) -> Found | None:
    """Run the attack of one task and compare every rendering with the reference. None if the vehicle finds no place."""
    configure_runtime(1)
    task = plan.tasks[index]
    spec, assets = task.spec, load_assets(plan.assets[task.assets])
    placement = place_vehicle(spec, assets)
    if isinstance(placement, NoPlacement):
        return None
    problem = build_problem(spec, assets, placement.theta)
    problem = replace(problem, detector=assets.detector_of(spec.detector, "float32"))
    true = replace(problem, field_of=assets.decoder_of(REFERENCE.dtype).field, settings=REFERENCE, space=None,
                   code0=problem.code0.to(REFERENCE.dtype))  # fmt: skip
    words = [word for word in spec.vehicle.split("_") if len(word) < 20]  # without a digest
    found = Found(f"{' '.join(words)} at {math.hypot(*placement.theta[:2].tolist()):.1f} m, {spec.mode}")
    steps = 0

    def see(code: Tensor, theta: Tensor, warm: WarmStart | None, rendering: Rendering) -> None:
        nonlocal steps
        with torch.no_grad():
            found.hold(true, code.to(REFERENCE.dtype), theta, rendering)
        if steps % GRADIENT_EVERY == 0:
            whole, renderer = _cosines(problem, true, code, theta, warm, spec.mode)
            found.cosines += (whole,)
            found.renderer_cosines += (renderer,)
        steps += 1

    search_task(spec, Watched(**vars(problem), see=see), assets)
    return found


def _cosines(
    problem: AttackProblem, true: AttackProblem, code: Tensor, theta: Tensor, warm: WarmStart | None, mode: str
) -> tuple[float, float]:
    """Return the cosine of the loss's gradient by the attack's variables: as it is, and of the renderer alone."""
    of_code, of_pose = mode != "pose", mode != "shape"
    step = partial(attack_step, radius_m=ATTACK_RADIUS_M, of_code=of_code, of_pose=of_pose)
    truth = step(true, code.to(REFERENCE.dtype), theta)

    def least(at_points: Tensor | None) -> float:
        own = step(problem, code, theta, warm=warm, at_points=at_points)
        pairs = ((own.dz, truth.dz, of_code), (own.dtheta, truth.dtheta, of_pose))
        return min(cosine(one, two) for one, two, on in pairs if on)

    return least(None), least(truth.at_points)


def figures(every: Sequence[Found], of: str) -> dict[str, dict[str, object]]:
    """Return the figures of each attack, and of all attacks together."""
    named: dict[str, dict[str, object]] = {}
    for one in (*every, sum(every, Found("together"))):
        depth_mm = 1e3 * torch.tensor(one.depth_m or (math.nan,), dtype=torch.float64)
        for what, value, unit in (
            ("hits", one.hits, ""),
            ("lost", one.lost, ""),
            ("lost of 2 cm", one.lost_thick, ""),
            ("false", one.false, ""),
            ("depth p99", float(depth_mm.quantile(0.99)), "mm"),
            ("depth max", float(depth_mm.max()), "mm"),
            ("least cosine", min(one.cosines), ""),
            ("least cosine of the renderer", min(one.renderer_cosines), ""),
        ):
            named[f"{of}{one.name}/{what}"] = {"value": value, "unit": unit}
    return named


def main(words: Sequence[str]) -> int:
    """Print the figures and write them."""
    from shift3d.settings.compose import compose_sweep
    from shift3d.sweep.planning.kind import shift3d_kind
    from shift3d.sweep.planning.plan import make_plan

    own = dict(word.split("=", 1) for word in words if word.split("=")[0] in ("workers", "json", "of"))
    settings = [word for word in words if word.split("=")[0] not in own]
    plan, _ = make_plan(compose_sweep("default", [*SWEEP, *settings]), shift3d_kind().catalogue)
    context = multiprocessing.get_context("spawn")
    every: list[Found] = []
    with ProcessPoolExecutor(int(own.get("workers", 1)), context) as pool:
        for one in pool.map(attacked, [plan] * len(plan.tasks), range(len(plan.tasks))):
            if one is not None:
                every.append(one)
                least = f"least cosine {min(one.cosines):.6f}, of the renderer {min(one.renderer_cosines):.6f}"
                print(f"{one.name}: {one.lost} lost of {one.hits}, {least}", flush=True)
    text = json.dumps(figures(every, own.get("of", "")), indent=1) + "\n"
    if "json" in own:
        write_atomic(Path(own["json"]), text.encode())
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
