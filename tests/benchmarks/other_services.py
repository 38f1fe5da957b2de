"""Other grid runners on N empty jobs: seconds per job as JSON.

Each runner works in one process: a few jobs, which start everything, a few again, then many. The time per job is the
difference of the last two, after the start.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path

FEW = 4


def per_job(seconds: dict[int, float]) -> dict[str, float]:
    """Return seconds per job from the times for two numbers of jobs."""
    few, many = sorted(seconds)
    return {"ms": 1e3 * (seconds[many] - seconds[few]) / (many - few), "jobs": many}


def hydra_multirun(launcher: str, jobs: int) -> dict[str, float]:
    """Time Hydra's own multirun of an empty function. launcher: basic or ray."""
    import hydra

    @hydra.main(version_base=None, config_path=None)
    def nothing(config: object) -> None:
        return None

    words = ["hydra.job_logging.root.level=ERROR", "hydra.hydra_logging.root.level=ERROR"]
    if launcher == "ray":
        settings = {"address": "local", "num_cpus": 2, "include_dashboard": "false", "log_to_driver": "false"}
        words += ["hydra/launcher=ray", *(f"+hydra.launcher.ray.init.{key}={value}" for key, value in settings.items())]
    seconds = {}
    for count in (FEW - 1, FEW, jobs):
        axis = f"+x=range(0,{count})"
        sys.argv = ["nothing", "-m", axis, f"hydra.sweep.dir={Path.cwd() / launcher}", *words]
        began = time.perf_counter()
        nothing()
        seconds[count] = time.perf_counter() - began
    del seconds[FEW - 1]
    return per_job(seconds)


def ray_tune(jobs: int) -> dict[str, float]:
    """Time Ray Tune with two actors that are reused for every trial."""
    import ray
    from ray import tune

    class Nothing(tune.Trainable):  # type: ignore[misc]
        def step(self) -> dict[str, object]:
            return {"score": 0.0, "done": True}

        def reset_config(self, new_config: object) -> bool:
            return True

        def save_checkpoint(self, checkpoint_dir: str) -> None:
            return None

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    seconds = {}
    for count in (FEW - 1, FEW, jobs):
        tuner = tune.Tuner(
            Nothing,
            param_space={"x": tune.grid_search(list(range(count)))},
            tune_config=tune.TuneConfig(reuse_actors=True, max_concurrent_trials=2),
            run_config=tune.RunConfig(storage_path=str(Path.cwd() / f"tune{count}"), verbose=0),
        )
        began = time.perf_counter()
        results = tuner.fit()
        seconds[count] = time.perf_counter() - began
        assert len(results) == count and not results.errors
    del seconds[FEW - 1]
    return per_job(seconds)


def main(name: str, jobs: str) -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        with contextlib.redirect_stdout(sys.stderr):
            found = ray_tune(int(jobs)) if name == "tune" else hydra_multirun(name, int(jobs))
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
