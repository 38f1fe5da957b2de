"""A real but cheap kind of task: a pure function of its spec, run through the same service as the real task.

SHIFT3D_TEST_* variables make it slow, or make a chosen task fail, hang, kill its process, or return a bad row.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.seeding import derive_seed, generator
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.schema.config import Config
from shift3d.settings.schema.scenes import StreetConfig
from shift3d.sweep.planning.kind import TaskKind
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.spec import TaskSpec

POSE = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")


def load(spec: AssetsSpec) -> dict[str, float]:
    """Return the scale of the scores, from the decoder's file if the settings name a folder of vehicles.

    SHIFT3D_TEST_DATA: a folder that has to exist.
    """
    if (data := os.environ.get("SHIFT3D_TEST_DATA")) and not Path(data).is_dir():
        raise InputError("no such folder", where=data, remedy="Mount it")
    if folder := spec.vehicles["folder"]:
        return {"weight": float((Path(folder) / "sdf.safetensors").read_text())}
    assert "torch" not in sys.modules or "pytest" in sys.modules, "every driver and worker would take 2 s longer"
    return {"weight": 0.5}


def run(spec: TaskSpec, assets: dict[str, float]) -> TaskResult:
    _misbehave(spec)
    rng = generator(derive_seed("task", spec.task_id))
    where = generator(spec.placement_seed).uniform(15, 50, size=6)
    methods = [("baseline", 0), ("random", 0), ("adversarial", 0)]
    if spec.mode == "shape":
        methods += [("adversarial_noise", i) for i in range(spec.attack.noise_replicates)]
    scores, solutions = [], []
    for method, replicate in methods:
        key = {"method": method, "replicate": replicate, **dict(zip(POSE, where.tolist()))}
        score = float(rng.uniform(0.5, 1.0)) * (assets["weight"] if method.startswith("adv") else 1.0)
        row = {
                **key,
                "score": score,
                "adversarial_loss": score,
                "range_m": 20.0,
                "latent_distance": 0.1,
                "object_points": 400,
                "overlap_ok": True,
                "contact_ok": True,
                "best_step": 3,
                "status": "ok",
                "max_residual_m": 0.0,
                "unresolved_beams": 0,
        }  # fmt: skip
        scores += [{**row, "scored_by": name} for name in spec.scored_by]
        solutions.append({**key, "latent_code": rng.normal(size=4).astype("float32")})
    if f"{spec.vehicle}/{spec.scene}/{spec.mode}" == os.environ.get("SHIFT3D_TEST_BAD_ROW"):
        scores[0]["score"] = float("nan")
    timings = [{"method": "adversarial", "stage": "total", "milliseconds": 1.0, "calls": 1}]
    return TaskResult(scores, solutions, timings)


def _misbehave(spec: TaskSpec) -> None:
    time.sleep(float(os.environ.get("SHIFT3D_TEST_SECONDS", "0")))
    if journal := os.environ.get("SHIFT3D_TEST_JOURNAL"):
        with Path(journal).open("a") as file:
            file.write(f"{spec.task_id}\n")
    target = f"{spec.vehicle}/{spec.scene}/{spec.mode}"
    gate = os.environ.get("SHIFT3D_TEST_GATE")
    if gate and spec.scene == "street_003":
        Path(f"{gate}.{os.getpid()}").touch()
        while not Path(gate).exists():
            time.sleep(0.02)
    if target == os.environ.get("SHIFT3D_TEST_HANGS") and _not_yet("SHIFT3D_TEST_HANG_ONCE"):
        time.sleep(3600)
    if target == os.environ.get("SHIFT3D_TEST_HUNGRY"):
        _eat()
    if (fails := os.environ.get("SHIFT3D_TEST_FAILS")) and target.startswith(fails):
        raise ArithmeticError(f"no root for {target}")
    crashes_once = os.environ.get("SHIFT3D_TEST_CRASHES_ONCE")
    if target == os.environ.get("SHIFT3D_TEST_CRASHES") or (
        target == crashes_once and _not_yet("SHIFT3D_TEST_CRASHED")
    ):
        os.kill(os.getpid(), signal.SIGKILL)


def _not_yet(variable: str) -> bool:
    """True the first time only, if a variable names a file as memory; True always, if the variable is not set."""
    mark = os.environ.get(variable)
    if mark is None:
        return True
    first = not Path(mark).exists()
    Path(mark).touch()
    return first


def _eat() -> None:
    """Request more memory than this process may have from then on, as under a cluster's limit."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + 64 * 2**20, before[1]))
    try:
        bytearray(2**31)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _jumping_clock(seed: int) -> Callable[[], float]:
    """Return a wall clock that jumps back and forth by up to a day at each reading."""
    chance, real = random.Random(seed), time.time
    return lambda: real() + chance.uniform(-86_400, 86_400)


# In the driver and in every worker: both import this module.
if "SHIFT3D_TEST_CLOCK" in os.environ:
    time.time = _jumping_clock(int(os.environ["SHIFT3D_TEST_CLOCK"]))


def catalogue(config: Config) -> Catalogue:
    assert isinstance(config.scenes, StreetConfig)
    names = [f"street_{i:03d}" for i in range(config.scenes.count)]
    return Catalogue(
        scenes=tuple(SceneEntry(name, "street-hdl64", f"hash-{name}", SceneFacts(name)) for name in names),
        scene_arguments={"kind": "street"},
        sector_rad=(0.0, 3.14),
        vehicles={name: f"hash-{name}" for name in ("coupe", "sports_car", "suv", "convertible", "beach_wagon")},
        decoder_hash="decoder",
        detectors={config.detector.name: "detector"},
        accuracy={},
    )


def instructions() -> str:
    """No instruction of a processor changes a number here, and nothing here needs torch, which takes 2 s to import."""
    return "any instructions"


KIND = TaskKind(run=run, load=load, catalogue=catalogue, memory_mb=200, instructions=instructions)
