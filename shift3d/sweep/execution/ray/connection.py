"""Connection to Ray: a private instance on this machine, or a running cluster."""

from __future__ import annotations

import contextlib
import functools
import logging
import math
import os
import signal
import socket
import sys
from collections.abc import Iterator
from typing import Any

from shift3d.errors import InputError
from shift3d.processor import usable_cpus
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray.token import require_token

# A private Ray has no dashboard that could show these counters and events.
_UNCOUNTED = {
    "enable_metrics_collection": False,
    "enable_open_telemetry": False,
    "event_stats": False,
    "task_events_report_interval_ms": 0,
}


def connect(config: RayRunnerConfig, tasks_left: int) -> Any:
    """Start or join Ray, and return the module, ready to use.

    A private Ray listens on loopback only, has no dashboard and none of its counters, and asks every client for the
    token of its owner.

    tasks_left: maximum number of workers of a private Ray.
    Raises: InputError: Ray does not start, the cluster does not answer, or it rejects our token.
    """
    for name, value in (
        ("RAY_USAGE_STATS_ENABLED", "0"),
        ("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0"),
        ("RAY_DISABLE_IMPORT_WARNING", "1"),
        ("OMP_NUM_THREADS", "1"),
    ):
        os.environ.setdefault(name, value)
    if not require_token(private=not config.address) and config.address:
        print(
            f"warning: no token of the Ray at {config.address} is known. If it asks for none, whoever reaches it can "
            "run code there",
            file=sys.stderr,
        )
    import ray

    where = f"runner.address={config.address}"
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if config.address:
            _check_token(config.address)
            ray.init(address=config.address, **quiet)
        else:
            workers = min(config.workers_on(usable_cpus()), max(tasks_left, 1))
            with _on_loopback(), _without_unused_services(), _sigterm_blocked():
                ray.init(
                    address="local",
                    num_cpus=max(1, math.ceil(workers * config.cpus_per_worker)),
                    include_dashboard=False,
                    _node_ip_address="127.0.0.1",
                    object_store_memory=256 * 2**20,
                    _system_config=_UNCOUNTED,
                    **quiet,
                )
    except ray.exceptions.AuthenticationError as error:
        remedy = "Copy the token from there, or name its file in RAY_AUTH_TOKEN_PATH"
        raise InputError("this Ray asks for a token, and ours is none or another one", where, remedy) from error
    except (ConnectionError, RuntimeError, ValueError, OSError, ray.exceptions.RpcError) as error:
        message = " ".join(str(error).split())[:300]
        raise InputError(f"Ray did not start: {message}", where, "Check the address, or use runner=local") from error
    return ray


def _check_token(address: str) -> None:
    """Check that a cluster accepts our token: ``ray.init`` would try for 20 s and then not say why it failed.

    Raises: ray.exceptions.AuthenticationError: it rejects the token. OSError: nothing answers at the address.
    """
    from ray._common.network_utils import parse_address  # type: ignore[attr-defined]
    from ray._private.services import canonicalize_bootstrap_address
    from ray._raylet import GcsClient  # type: ignore[attr-defined]

    known = None if "://" in address else canonicalize_bootstrap_address(address)
    if known and (found := parse_address(known)):
        socket.create_connection((found[0], int(found[1])), timeout=10).close()
        GcsClient(address=known).check_alive([], timeout=10)


def ended_process() -> InputError | None:
    """Return the error for a process of a private Ray that has ended: Ray would end this process without a reason."""
    from ray._private import worker

    node = worker._global_node  # None, or without processes, where a cluster is joined
    if node is None or node.remaining_processes_alive():
        return None
    what = f"Ray's {node.dead_processes()[0][0]} ended early, as when memory runs out"
    return InputError(what, "this machine", "Run the same command again: it resumes")


@contextlib.contextmanager
def _sigterm_blocked() -> Iterator[None]:
    """Block SIGTERM for processes that start in this context, workers included; Ray itself blocks SIGINT for them.

    Programs that end a job (``timeout``, Slurm, systemd) often signal all its processes at once. A driver stops after
    the tasks in flight, and needs its Ray until then.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _without_unused_services() -> Iterator[None]:
    """Keep a starting Ray from starting processes that no sweep uses, for which ``ray.init`` has no option.

    These are the log reader for a driver that wants no logs, the autoscaler's monitor, and the server of a disabled
    dashboard. Each takes half a second to start, and ``ray.init`` waits for the last; then each wakes 20 to 30 times a
    second, beside workers that use every core.

    The agent, without which no node starts, gets a free port instead of 52365: a cluster's head on this machine wants
    that port, and takes no jobs without it.
    """
    from ray._private.node import Node
    from ray._private.parameter import RayParams

    before, server = RayParams.__init__, Node.start_api_server
    needed = {"dashboard_agent_listen_port": 0, "include_log_monitor": False, "no_monitor": True}
    RayParams.__init__ = functools.partialmethod(before, **needed)  # type: ignore[assignment, method-assign]
    Node.start_api_server = lambda *_, **__: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        RayParams.__init__, Node.start_api_server = before, server  # type: ignore[method-assign]


@contextlib.contextmanager
def _on_loopback() -> Iterator[None]:
    """Keep a starting Ray from replacing 127.0.0.1 by the machine's own address.

    On Linux Ray does so with any options, and its servers then listen on every interface. On Windows and macOS it does
    not, because of their firewalls; the switch between the two is the only one (Ray 2.60).
    """
    from ray._private import ray_constants

    name, before = ray_constants.ENABLE_RAY_CLUSTERS_ENV_VAR, ray_constants.ENABLE_RAY_CLUSTER
    former = os.environ.get(name)
    os.environ[name] = "0"  # for the processes that Ray starts
    ray_constants.ENABLE_RAY_CLUSTER = False  # for this process, which has read the variable already
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before
        if former is None:
            del os.environ[name]
        else:
            os.environ[name] = former


def node_of(ray: Any, actor: Any) -> tuple[str, str]:
    """Return the Ray id and the name of the machine that an actor is placed on; ("", "") if there is none."""
    try:
        address = ray._private.state.actors(actor._actor_id.hex()).get("Address", {})
    except Exception:  # no public function; Ray's Client (ray://) lacks it altogether
        return "", ""
    named = {node.get("NodeID"): node.get("NodeManagerHostname") for node in ray.nodes()}
    node_id = str(address.get("NodeID", ""))
    return (node_id, named[node_id]) if node_id in named else ("", "")
