"""Launch specs on a real head start the same sweep: its bytes equal those of an in-process run.

The machines have shift3d from its wheel alone.
"""

from __future__ import annotations

import shlex
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import yaml
from jobs.ray_head import SERVICE, ray_head
from service.drivers import DETERMINISTIC, Drivers

JOBS = Path(__file__).resolve().parents[2] / "jobs"
WORDS = ("scenes.count=4", "tracking=none")
WORKERS = {"slurm": 2, "job": 1}


@pytest.fixture(scope="module")
def dashboard_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture(scope="module")
def environment(dashboard_port: int, python: Path) -> Iterator[dict[str, str]]:
    with ray_head(dashboard_port, python, SERVICE) as found:
        yield found


def job_of(folder: Path, dashboard_port: int) -> Path:
    """Return the spec of a Ray job on the existing head."""
    spec = (JOBS / "ray_job.yaml").read_text().replace(":8265\nruntime", f":{dashboard_port}\nruntime")
    (folder / "job.yaml").write_text(spec)
    return folder / "job.yaml"


def commands(folder: Path, dashboard_port: int) -> dict[str, str]:
    """Return commands for a small sweep by Slurm, whose script gives job=ray_cluster, and by the Jobs API."""
    start = {
        "slurm": f"bash {JOBS / 'slurm.sbatch'}",
        "job": f"shift3d sweep job={job_of(folder, dashboard_port)}",
    }
    words = f"mine {shlex.join(WORDS)}"
    return {
        name: f"{command} {words} runner.workers={WORKERS[name]} out={folder / name}" for name, command in start.items()
    }


def test_every_spec_starts_the_same_sweep(
    environment: dict[str, str], dashboard_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sweep is in the command's own folder, with a group of its own: both must travel with a job."""
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "conf" / "attack").mkdir(parents=True)
    (tmp_path / "sweeps" / "mine.yaml").write_text("defaults: [default, override /attack: tiny, _self_]\n")
    (tmp_path / "conf" / "attack" / "tiny.yaml").write_text("defaults: [paper, _self_]\nsteps: 3\n")
    slurm = {"SLURM_JOB_NODELIST": "node[1-2]", "SLURM_JOB_NUM_NODES": "2", "SLURM_CPUS_ON_NODE": "2"}
    # At once, because each of them waits for Ray most of the time.
    running = {
        name: subprocess.Popen(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=environment | slurm,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for name, command in commands(tmp_path, dashboard_port).items()
    }
    monkeypatch.syspath_prepend(SERVICE)  # for the kind of task
    here = ["sweep", "mine", *WORDS, "runner=local", f"out={tmp_path / 'here'}"]
    code, _, errors = Drivers(tmp_path).run_here(here)
    assert code == 0, errors
    for name, process in running.items():
        output, _ = process.communicate(timeout=240)
        assert process.returncode == 0, f"{name}: {output[-3000:]}"
        attempts = pd.read_parquet(tmp_path / name / "final" / "attempts.parquet")
        assert attempts["worker"].nunique() == WORKERS[name]
    found = {
        name: {table: (tmp_path / name / "final" / f"{table}.parquet").read_bytes() for table in DETERMINISTIC}
        for name in ("here", *running)
    }
    assert all(tables == found["here"] for tables in found.values())
    assert yaml.safe_load((tmp_path / "job" / "spec.yaml").read_text())["settings"]["attack"]["steps"] == 3


def test_a_job_hands_the_exit_code_of_its_sweep_on(
    environment: dict[str, str], dashboard_port: int, tmp_path: Path
) -> None:
    command = f"shift3d sweep nothing job={job_of(tmp_path, dashboard_port)} out={tmp_path / 'out'}"
    other = {**environment, "RAY_AUTH_TOKEN": "0" * 64}
    done, refused = (
        subprocess.Popen(["bash", "-c", command], env=known, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for known in (environment, other)
    )
    printed, errors = done.communicate(timeout=120)
    assert done.returncode == 2 and "nothing" in printed, (printed, errors)
    printed, errors = refused.communicate(timeout=120)
    assert refused.returncode == 2 and "the job cannot be submitted" in errors, (printed, errors)
