"""A Ray head on loopback, on which the tests of launch specs start sweeps, and the commands that launch specs call."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKED = ("shift3d", "conf", "sweeps", "jobs")
"""Folders of the repository that the wheel holds."""
SERVICE = REPOSITORY / "tests" / "service"

# `ray symmetric-run` ends with `ray stop`, which would end every Ray of this machine. The stub lets Ray's own commands
# parse its options and those passed on to `ray start`, and runs the program on the existing head.
_RAY = """#!{python}
import os, subprocess, sys
from ray.scripts.scripts import start
from ray.scripts.symmetric_run import curate_and_validate_ray_start_args, symmetric_run
words = sys.argv[2:]
options, program = words[:words.index("--")], words[words.index("--") + 1:]
assert sys.argv[1] == "symmetric-run" and program
assert symmetric_run.make_context("symmetric-run", options).params["address"].startswith("first-node:")
start.make_context("start", ["--head", *curate_and_validate_ray_start_args(options)])
own, heads = os.environ["RAY_AUTH_TOKEN"], os.environ["SHIFT3D_TEST_TOKEN"]
assert len(own) == 64 and own != heads and os.environ["RAY_AUTH_MODE"] == "token"
sys.exit(subprocess.call(program, env={{**os.environ, "RAY_AUTH_TOKEN": heads}}))
"""
_DRIVER = '#!/bin/sh\nexec {python} {driver} "$@"\n'
_COMMANDS = {
    # Every task of a step is the same program: one task represents all.
    "srun": '#!/bin/sh\nwhile [ "${1#--}" != "$1" ]; do shift; done\nexec "$@"\n',
    # More than a pipe holds, so that a reader that stops early is noticed every time.
    "scontrol": "#!/bin/sh\necho first-node\nseq -f node-%g 20000\n",
}


@contextlib.contextmanager
def ray_head(dashboard_port: int, python: Path, modules: Path) -> Iterator[dict[str, str]]:
    """Run a head with room for eight workers. Yields the environment in which a launch spec's commands find it.

    dashboard_port: of the dashboard, which serves the Jobs API. python: of the machines. modules: folder of modules
    that are not installed there.
    """
    folder = Path(tempfile.mkdtemp(prefix="s3d-"))  # short, because Ray puts sockets there
    driver = _DRIVER.format(python=python, driver=SERVICE / "driver.py")
    for name, text in {**_COMMANDS, "shift3d": driver, "ray": _RAY.format(python=python)}.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{folder}:{os.environ['PATH']}",
        "PYTHONPATH": str(modules),
        "OMP_NUM_THREADS": "1",
        "SHIFT3D_TEST_SECONDS": "0.1",  # long enough that every worker runs tasks
        "SHIFT3D_TEST_TOKEN": os.environ["RAY_AUTH_TOKEN"],
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # 127.0.0.1 stays 127.0.0.1
    }
    command = [str(python), "-m", "ray.scripts.scripts", "start", "--head", "--block", "--port=0", "--num-cpus=8"]
    command += ["--node-ip-address=127.0.0.1", f"--temp-dir={folder}", "--object-store-memory=100000000"]
    command += ["--no-monitor", "--include-log-monitor=false"]  # for an autoscaler, and for drivers that want logs
    command += ["--include-dashboard=true", "--dashboard-host=127.0.0.1", f"--dashboard-port={dashboard_port}"]
    # Jobs need an agent, and another Ray of this machine may use Ray's default port for it.
    command += [f"--dashboard-agent-listen-port={_free_port()}"]
    log = folder / "start.log"
    with log.open("w") as file:
        process = subprocess.Popen(
            command,
            env=environment,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield {**environment, "RAY_ADDRESS": _address(process, log)}
    finally:
        process.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=30)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        shutil.rmtree(folder, ignore_errors=True)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    """Return the head's address, which Ray writes after it has reported that it runs."""
    file = log.parent / "ray_current_cluster"
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline:
        address = file.read_text().strip() if file.exists() else ""
        if address:
            return address
        assert process.poll() is None, log.read_text()
        time.sleep(0.1)
    raise AssertionError(f"the head does not start: {log.read_text()}")
