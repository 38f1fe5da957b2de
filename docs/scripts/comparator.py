"""Comparison of renderings and whole tasks between the working tree and an earlier commit, in turns on one machine.

``python docs/scripts/comparator.py COMMIT [steps=12] [turns=2] [tasks=true] [json=FILE]``

Both versions render the same codes and poses with the same decoder, in processes of one thread. Renderings are warm and
ready for a gradient, as in an attack; shapes are also rendered cold without a grid. A hit is lost when a version misses
it or places it more than 1 cm off `reference`. Tasks are those of the default sweep in one street of `val`; each
version places, searches and scores them in its own way, with the detector's weights of the earlier commit. The script
refuses an earlier version whose decoder differs.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

HERE = Path(__file__).resolve().parents[2]
ATTACKS = (
    *("vehicle=suv,coupe,sports_car", "mode=shape,pose", "attack.lambda=1", "scenes.split=val", "scenes.count=1"),
    *("naturalness=none", "effects=none"),
)
TASKS = ("attack.lambda=1", "scenes.split=val", "scenes.count=1", "tracking=none", "runner.workers=2")
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
WRONG_SURFACE_M = 0.01


@dataclass(frozen=True)
class Frame:
    """Transform from a vehicle's object frame to its sdf frame, with the attributes that every version reads."""

    scale_m: float
    sdf_R_object: np.ndarray  # noqa: N815
    sdf_t_object: np.ndarray
    size_m: tuple[float, ...]


def record(folder: Path, steps: int) -> None:
    """Record attacks of the working tree, one file each: beams, vehicle, every code and pose, and the true hits."""
    from recorded_attacks import Watched

    from shift3d.placement.sampling import NoPlacement
    from shift3d.processor import configure_runtime
    from shift3d.render.render import render
    from shift3d.render.settings import REFERENCE
    from shift3d.settings.compose import compose_sweep
    from shift3d.sweep.planning.kind import shift3d_kind
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.task.assets import load_assets
    from shift3d.task.problem import build_problem, place_vehicle
    from shift3d.task.searching import search_task

    configure_runtime(1)
    plan, _ = make_plan(compose_sweep("default", [*ATTACKS, f"attack.steps={steps}"]), shift3d_kind().catalogue)
    for task in plan.tasks:
        spec, assets = task.spec, load_assets(plan.assets[task.assets])
        placement = place_vehicle(spec, assets)
        if isinstance(placement, NoPlacement):
            continue
        seen: list[tuple[Tensor, Tensor]] = []
        problem = build_problem(spec, assets, placement.theta)
        watched = Watched(**vars(problem), see=lambda code, theta, *_, seen=seen: seen.append((code, theta)))
        search_task(spec, watched, assets)
        field_of, vehicle = assets.decoder_of(REFERENCE.dtype).field, problem.vehicle
        with torch.no_grad():
            true = [render(problem.beams, field_of(c.double()), t, vehicle, REFERENCE) for c, t in seen]
        parts = {
            "points": problem.beams.points,
            "origins": problem.beams.origins,
            "codes": torch.stack([code for code, _ in seen]),
            "poses": torch.stack([theta for _, theta in seen]),
            "range_m": torch.stack([torch.where(one.hit_mask, one.range_m, torch.nan) for one in true]),
            "scale_m": torch.tensor(float(vehicle.scale_m)).double(),
            "sdf_R_object": torch.as_tensor(np.asarray(vehicle.sdf_R_object, dtype=np.float64)),
            "sdf_t_object": torch.as_tensor(np.asarray(vehicle.sdf_t_object, dtype=np.float64)),
            "size_m": torch.as_tensor([float(side) for side in vehicle.size_m], dtype=torch.float64),
        }
        words = " ".join(word for word in spec.vehicle.split("_") if len(word) < 20)
        name = f"{words} at {math.hypot(*placement.theta[:2].tolist()):.0f} m, {spec.mode}"
        save_file({key: part.clone().contiguous() for key, part in parts.items()}, folder / f"{name}.safetensors")


def replay(folder: Path, to: Path) -> None:
    """Render every recorded attack with the version that Python imports: milliseconds, hits and lost hits."""
    from shift3d.render.beams import Beams
    from shift3d.render.render import render
    from shift3d.sdf.decoder import load_decoder

    torch.set_num_threads(1)
    decoder, found = load_decoder(), {}
    for file in sorted(folder.glob("*.safetensors")):
        parts = load_file(file)
        beams = Beams.from_arrays(parts["points"], parts["origins"])
        size_m = tuple(parts["size_m"].tolist())
        frame = Frame(float(parts["scale_m"]), parts["sdf_R_object"].numpy(), parts["sdf_t_object"].numpy(), size_m)
        of_pose = file.stem.endswith("pose")
        grid = _grid_type(render).of(decoder.field(parts["codes"][0]), frame) if of_pose else None
        for how in ("warm",) if of_pose else ("warm", "cold, no grid"):
            milliseconds, lost, warm = [], 0, None
            for number, code, theta, true_m in zip(
                range(len(parts["codes"])), parts["codes"], parts["poses"], parts["range_m"], strict=True
            ):
                code, theta = code.clone().requires_grad_(not of_pose), theta.clone().requires_grad_(of_pose)
                start = time.perf_counter()
                rendering = render(beams, decoder.field(code), theta, frame, warm=warm, **_with(render, grid))
                if number:  # the first rendering is cold in any case
                    milliseconds.append(1e3 * (time.perf_counter() - start))
                warm = rendering.warm if how == "warm" else None
                off_m = (rendering.range_m.detach() - true_m).abs()
                lost += int((~true_m.isnan() & ~(rendering.hit_mask & (off_m <= WRONG_SURFACE_M))).sum())
            hits = int((~parts["range_m"].isnan()).sum())
            found[f"{file.stem}, {how}"] = {"milliseconds": milliseconds, "lost": lost, "hits": hits}
    to.write_text(json.dumps(found))


def _with(render: Any, grid: object) -> dict[str, object]:
    """Return the grid as a keyword argument, under the name that this version's `render` gives it."""
    return {list(inspect.signature(render).parameters)[-1]: grid}


def _grid_type(render: Any) -> Any:
    """Return the class of a version's grid, read from the annotation of `render`'s grid parameter."""
    annotation = str(list(inspect.signature(render).parameters.values())[-1].annotation)
    return getattr(inspect.getmodule(render), annotation.split()[0])


def task_seconds(tree: Path, out: Path, *words: str) -> float:
    """Return the seconds of all tasks of the default sweep together, run by the version in `tree`."""
    import pandas as pd

    _run(tree, "-m", "shift3d", "sweep", "default", *TASKS, *words, f"out={out}")
    timings = pd.read_parquet(out / "final/timings.parquet")
    return float(timings[timings["stage"] == "total"]["milliseconds"].sum() / 1e3)


def earlier_detector(tree: Path, to: Path) -> Path:
    """Write the weights of PointPillars in `tree`; a tensor that they lack has the value of a new network."""
    from shift3d.detectors.models.pillar_detectors import PointPillarsNet

    save_file(PointPillarsNet().state_dict() | load_file(tree / "shift3d/weights/pointpillars.safetensors"), to)
    return to


def _run(tree: Path, *words: str) -> None:
    env = {**os.environ, **THREADS, "PYTHONPATH": str(tree)}
    subprocess.run([sys.executable, *words], env=env, cwd=tree, check=True, stdout=sys.stderr)


def earlier_tree(commit: str, folder: Path) -> Path:
    """Extract the files of a commit into a folder. Raises: SystemExit if the commit's decoder differs."""
    archive = subprocess.run(["git", "archive", commit], cwd=HERE, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    weights = "shift3d/weights/sdf.safetensors"
    if (folder / weights).read_bytes() != (HERE / weights).read_bytes():
        raise SystemExit(f"{commit}: its decoder, {weights}, is not this version's: renderings cannot be compared")
    return folder


def figures(of: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterator[tuple[str, float, str]]:
    """Yield name, value and unit of every figure. of: results of `replay` by side, one entry per turn."""
    for name, first in of["after"][0].items():
        medians: dict[str, list[float]] = {}
        for side, turns in of.items():
            medians[side] = [statistics.median(turn[name]["milliseconds"]) for turn in turns]
            for number, value in enumerate(medians[side], start=1):
                yield f"{name}/{side} {number}", value, "ms"
            yield f"{name}/lost {side}", turns[0][name]["lost"], ""
        yield f"{name}/hits", first["hits"], ""
        yield f"{name}/ratio", statistics.mean(medians["before"]) / statistics.mean(medians["after"]), "ratio"


def main(words: Sequence[str]) -> int:
    """Print the figures and write them."""
    if words[:1] == ["--replay"]:
        replay(Path(words[1]), Path(words[2]))
        return 0
    commit, given = words[0], dict(word.split("=", 1) for word in words[1:])
    turns = int(given.get("turns", 2))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sides = {"before": earlier_tree(commit, folder / "before"), "after": HERE}
        (attacks := folder / "attacks").mkdir()
        record(attacks, int(given.get("steps", 12)))
        found: dict[str, list[dict[str, Any]]] = {side: [] for side in sides}
        for _ in range(turns):
            for side, tree in sides.items():
                _run(tree, str(Path(__file__).resolve()), "--replay", str(attacks), str(folder / "found.json"))
                found[side].append(json.loads((folder / "found.json").read_text()))
        named = {key: {"value": value, "unit": unit} for key, value, unit in figures(found)}
        if given.get("tasks", "true") == "true":
            weights = earlier_detector(sides["before"], folder / "pointpillars.safetensors")
            tasks, seconds = "whole tasks of the default sweep", dict.fromkeys(sides, 0.0)
            for turn in range(1, turns + 1):
                for side, tree in sides.items():
                    words = [f"detector.weights={weights}"] if side == "after" else []
                    seconds[side] += (value := task_seconds(tree, folder / f"out_{side}_{turn}", *words))
                    named[f"{tasks}/{side} {turn}"] = {"value": value, "unit": "s"}
            named[f"{tasks}/ratio"] = {"value": seconds["before"] / seconds["after"], "unit": "ratio"}
    text = json.dumps(named, indent=1) + "\n"
    if "json" in given:
        Path(given["json"]).write_text(text)
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
