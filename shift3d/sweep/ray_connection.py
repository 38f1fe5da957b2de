"""Connecting to Ray: a private one on this machine, or a cluster that is running."""

from __future__ import annotations

import logging
import math
import os
from typing import Any

from shift3d.config.schema import RayRunnerConfig
from shift3d.errors import InputError

__all__ = ["connect"]


def connect(config: RayRunnerConfig, tasks_left: int) -> Any:
    """Ray, started or joined: the module, ready to use.

    tasks_left: a private Ray needs no more workers than this.

    Raises:
        InputError: Ray does not start, or the cluster does not answer.
    """
    for name, value in (
        ("RAY_USAGE_STATS_ENABLED", "0"),
        ("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0"),
        ("RAY_DISABLE_IMPORT_WARNING", "1"),
        ("OMP_NUM_THREADS", "1"),
    ):
        os.environ.setdefault(name, value)
    import ray

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if config.address:
            ray.init(address=config.address, **quiet)
        else:
            workers = min(config.workers or os.cpu_count() or 1, max(tasks_left, 1))
            ray.init(
                address="local",
                num_cpus=max(1, math.ceil(workers * config.cpus_per_worker)),
                include_dashboard=False,
                _node_ip_address="127.0.0.1",
                object_store_memory=256 * 2**20,
                **quiet,
            )
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        message = " ".join(str(error).split())[:300]
        raise InputError(
            f"Ray did not start: {message}",
            where=f"runner.address={config.address}",
            remedy="Check the address, or use runner=local",
        ) from error
    return ray
