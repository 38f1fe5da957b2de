"""A Ray cluster that loses and gains a machine in the middle of a sweep: complete, and the same bytes."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from drivers import Drivers
from ray.cluster_utils import Cluster

TASKS = 60
HERE = str(Path(__file__).resolve().parent)
MEGABYTES = 2**20


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the machines: a home, and the gate at which tasks wait."""
    return tmp_path_factory.mktemp("machines")


@pytest.fixture(scope="module")
def cluster(machines: Path) -> Iterator[Cluster]:
    """Two nodes with room for one worker each, in processes of their own on this machine."""
    with pytest.MonkeyPatch.context() as environment:
        # Workers have the environment of their node: the task by name, and the gate.
        environment.setenv("PYTHONPATH", os.pathsep.join([HERE, os.environ.get("PYTHONPATH", "")]))
        environment.setenv("SHIFT3D_TEST_SECONDS", "0.02")
        environment.setenv("SHIFT3D_TEST_GATE", str(machines / "gate"))
        environment.setenv("HOME", str(machines / "home"))
        environment.setenv("RAY_USAGE_STATS_ENABLED", "0")
        environment.setenv("RAY_DISABLE_IMPORT_WARNING", "1")
        environment.setenv("RAY_health_check_period_ms", "500")  # a node is lost after five; Ray's own: 15 s
        found = Cluster(initialize_head=True, head_node_args=node())
        try:
            found.add_node(**node())
            yield found
        finally:
            found.shutdown()


def node() -> dict[str, object]:
    return {"num_cpus": 1, "object_store_memory": 80 * MEGABYTES, "include_dashboard": False}


def workers_at_the_gate(folder: Path, workers: int) -> set[str]:
    """Return the process ids of the workers once this many wait at the gate."""
    deadline = time.monotonic() + 90
    while len(found := {mark.suffix[1:] for mark in folder.glob("gate.*")}) < workers:
        assert time.monotonic() < deadline, f"fewer than {workers} workers have come to a task that waits"
        time.sleep(0.05)
    return found


def test_a_node_that_goes_and_one_that_comes_change_nothing(
    cluster: Cluster, machines: Path, drivers: Drivers, undisturbed: dict[str, bytes]
) -> None:
    (machines / "gate").unlink(missing_ok=True)
    settings = ("runner.commit_seconds=0", "runner.batch_seconds=0.001", f"runner.address={cluster.address}")
    driver = drivers.start("out", *settings)
    # Every fourth task waits at the gate: first those of both workers, then those of the new worker.
    before = workers_at_the_gate(machines, 2)
    (leaving,) = cluster.worker_nodes
    cluster.remove_node(leaving, allow_graceful=False)
    cluster.add_node(**node())
    there = workers_at_the_gate(machines, 3)
    (machines / "gate").touch()
    _, errors = driver.communicate(timeout=120)
    assert driver.returncode == 0, errors
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("out") == undisturbed
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    assert not attempts["quarantined"].any()
    assert set(attempts["outcome"]) <= {"done", "node_lost", "unreachable"}, "a task was charged for its node's end"
    (came,) = there - before
    assert f"{socket.gethostname()}:{came}" in set(attempts.loc[attempts["outcome"] == "done", "worker"])


def test_files_that_only_the_driver_has_travel_and_a_node_that_cannot_load_is_left_out_and_named(
    cluster: Cluster, machines: Path, drivers: Drivers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder's name is relative to the driver's working directory; the workers have another one."""
    for mark in machines.glob("gate*"):
        mark.unlink()
    mine = drivers.folder / "mine"
    mine.mkdir()
    (mine / "vehicles.safetensors").write_text("not read by this kind of task")
    (mine / "sdf.safetensors").write_text("0.25")
    assert not Path("mine").exists(), "the nodes were started here, and would find it"
    code, _, errors = drivers.run("here", "vehicle.folder=mine", "runner=local", SHIFT3D_TEST_GATE="")
    assert code == 0, errors
    monkeypatch.setenv("SHIFT3D_TEST_DATA", "/nowhere/data")
    lame = cluster.add_node(**node())
    try:
        settings = ("runner.commit_seconds=0", f"runner.address={cluster.address}")
        driver = drivers.start("out", "vehicle.folder=mine", *settings)
        # The others wait at a task until it has failed.
        status = drivers.folder / "out" / "status.json"
        deadline = time.monotonic() + 90
        while not (status.exists() and json.loads(status.read_text()).get("left_out")):
            assert driver.poll() is None, driver.communicate()[1]
            assert time.monotonic() < deadline, "no machine is left out"
            time.sleep(0.1)
        line = f"{socket.gethostname()} is left out: /nowhere/data: no such folder. Mount it"
        shown = drivers.run_here(["sweep", "status", str(drivers.folder / "out")])[1]
        assert line in shown
        (machines / "gate").touch()
        output, errors = driver.communicate(timeout=120)
    finally:
        cluster.remove_node(lame, allow_graceful=False)
    assert driver.returncode == 0, errors
    assert errors.count(line) == 1, errors
    assert line in output, "the report does not name it"
    assert drivers.final("out") == drivers.final("here")
    attempts = pd.read_parquet(drivers.folder / "out" / "final" / "attempts.parquet")
    assert set(attempts["outcome"]) == {"done", "not_loaded"} and not attempts["quarantined"].any()
    (kept,) = (machines / "home" / ".shift3d" / "files").glob("*/sdf.safetensors")
    assert kept.read_text() == "0.25", "three workers, one copy"
