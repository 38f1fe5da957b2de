"""A Ray that a sweep starts: on loopback alone, without idle helpers, and closed to anyone without the token."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from ray._private import ray_constants

STARTS = """
import sys
import time
from shift3d.settings.compose import compose_sweep, validate
from shift3d.errors import InputError
from shift3d.sweep.execution.ray.connection import connect, ended_process

address = sys.argv[1] if len(sys.argv) > 1 else None
words = ["runner.workers=1", f"runner.address={address or 'null'}"]
try:
    ray = connect(validate(compose_sweep("smoke", words).base, "test").runner, 1)
except InputError as error:
    sys.exit(str(error))
print(ray.get_runtime_context().gcs_address, flush=True)
if address is None and sys.stdin.read():
    while not (error := ended_process()):
        time.sleep(0.05)
    print(error, flush=True)
ray.shutdown()
"""

USED = ("gcs_server", "raylet/raylet")
AGENT = ray_constants.DEFAULT_DASHBOARD_AGENT_LISTEN_PORT
UNUSED = ("dashboard/dashboard.py", "log_monitor.py", "monitor.py")


def without_a_token(home: Path, **more: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH_")}
    # Without the last variable, Ray would replace 127.0.0.1 by the address by which other machines know this one.
    return {**kept, "HOME": str(home), **more, "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}


@dataclass(frozen=True)
class PrivateRay:
    process: subprocess.Popen[str]
    address: str
    token: Path


@pytest.fixture(scope="module")
def private_ray(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrivateRay]:
    home = tmp_path_factory.mktemp("home")
    process = subprocess.Popen(
        [sys.executable, "-c", STARTS],
        env={**without_a_token(home), "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin and process.stdout
    yield PrivateRay(process, process.stdout.readline().strip(), home / ".shift3d" / "ray_token")
    process.stdin.close()
    process.wait(timeout=60)


def descendants(of: int) -> Iterator[int]:
    for children in Path(f"/proc/{of}/task").glob("*/children"):
        for child in children.read_text().split():
            yield int(child)
            yield from descendants(int(child))


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def listening(process: int) -> set[tuple[str, int]]:
    """Return addresses (hex, as in /proc/net) and ports on which a process listens."""
    inodes = {str(link.readlink()) for link in Path(f"/proc/{process}/fd").iterdir() if link.is_symlink()}
    rows = [row.split() for kind in ("tcp", "tcp6") for row in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]]
    local = [row[1].split(":") for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in inodes]
    return {(address, int(port, 16)) for address, port in local}


def joins(ray: PrivateRay, home: Path, **more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", STARTS, ray.address]
    environment = without_a_token(home, **more)
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_it_listens_on_loopback_alone(private_ray: PrivateRay) -> None:
    processes = list(descendants(private_ray.process.pid))
    found = set().union(*(listening(process) for process in processes))
    loopback = {"0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000"}
    assert found and {address for address, _ in found} <= loopback


def test_it_leaves_the_port_of_a_heads_agent_alone(private_ray: PrivateRay) -> None:
    own = {number for process in descendants(private_ray.process.pid) for _, number in listening(process)}
    if answers(AGENT) and AGENT not in own:
        pytest.skip("another Ray of this machine holds the port")
    assert own and AGENT not in own


def test_it_has_no_process_that_a_sweep_has_no_use_for(private_ray: PrivateRay) -> None:
    commands = [Path(f"/proc/{process}/cmdline").read_text() for process in descendants(private_ray.process.pid)]
    running = [name for name in (*USED, *UNUSED) if any(name in command for command in commands)]
    assert running == list(USED)


def test_its_token_is_its_owners(private_ray: PrivateRay) -> None:
    assert stat.S_IMODE(private_ray.token.stat().st_mode) == 0o600


def test_only_who_has_the_token_gets_in(private_ray: PrivateRay, tmp_path: Path) -> None:
    welcome = joins(private_ray, tmp_path, RAY_AUTH_TOKEN_PATH=str(private_ray.token))
    assert welcome.returncode == 0 and welcome.stdout.strip() == private_ray.address, welcome.stderr
    for more in ({}, {"RAY_AUTH_MODE": "disabled"}, {"RAY_AUTH_TOKEN": "0" * 64}):
        refused = joins(private_ray, tmp_path, **more)
        assert refused.returncode == 1 and refused.stdout == ""
        assert "asks for a token, and ours is none or another one" in refused.stderr, refused.stderr
        assert "Traceback" not in refused.stderr


def test_an_address_where_nobody_answers_is_said_at_once(private_ray: PrivateRay, tmp_path: Path) -> None:
    nobody = PrivateRay(private_ray.process, "127.0.0.1:9", private_ray.token)
    refused = joins(nobody, tmp_path, RAY_AUTH_TOKEN_PATH=str(private_ray.token))
    assert refused.returncode == 1
    assert "runner.address=127.0.0.1:9" in refused.stderr and "Connection refused" in refused.stderr


def test_the_driver_says_which_process_of_its_ray_was_killed(private_ray: PrivateRay) -> None:
    """It is the last test with this Ray."""
    commands = {pid: Path(f"/proc/{pid}/cmdline").read_text() for pid in descendants(private_ray.process.pid)}
    os.kill(next(pid for pid, command in commands.items() if "raylet/raylet" in command), signal.SIGKILL)
    assert private_ray.process.stdin and private_ray.process.stdout
    private_ray.process.stdin.write("killed")
    private_ray.process.stdin.close()
    output = private_ray.process.stdout.read()  # with lines of Ray's own
    assert "this machine: Ray's raylet ended early" in output and "it resumes" in output
