"""Sweep driver on a cluster, submitted through Ray's Jobs API and followed from this machine."""

from __future__ import annotations

import asyncio
import re
import shlex
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.sweep.execution.ray.token import require_token

_INSTALL = "Install its parts: pip install -c constraints.txt 'ray[default]'"


def submit_sweep(
    words: Sequence[str], address: str, runtime_env: dict[str, Any] | None, folders: Sequence[Path] = ()
) -> int:
    """Run ``shift3d sweep WORDS`` on a cluster, print its output, and return its exit code.

    Ctrl-C stops the printing; the sweep goes on.

    Args:
        words: with an ``out=`` that means the same on the cluster's machines and on this one.
        address: of the cluster's dashboard, ``http://HOST:PORT``.
        runtime_env: Ray's runtime environment of the job's processes.
        folders: copied into the job's working directory, which runtime_env then cannot name.

    Raises: InputError: no absolute ``out=``, the cluster does not answer or refuses us, or the job cannot start.
    """
    if not any(re.match(r"out=(/|\w+://)", word) for word in words):
        raise InputError(
            "a relative out= would be a folder of the job, removed with it",
            where="job=ray_job",
            remedy="Give out=s3://BUCKET/FOLDER, or a path that is the same on every machine: out=/shared/FOLDER",
        )
    require_token(private=False)
    command = shlex.join(["shift3d", "sweep", *words])
    with tempfile.TemporaryDirectory() as copies:
        client, job = _submit(address, command, _with_folders(runtime_env or {}, folders, Path(copies)))
    print(f"{job} on {address}: {command}", flush=True)
    try:
        asyncio.run(_show(client, job))
        details = client.get_job_info(job)
    except KeyboardInterrupt:
        print(f"\nthe sweep goes on; to end it as Ctrl-C would: ray job stop {job} --address {address}")
        return int(ExitCode.INTERRUPTED)
    # If the tunnel or the dashboard is gone, Ray, aiohttp and requests raise different errors.
    except Exception as error:
        raise _unseen(job, address, error) from error
    if details.status in ("PENDING", "RUNNING"):
        raise _unseen(job, address, f"it is {details.status}")
    if details.status == "SUCCEEDED":
        return 0
    if details.driver_exit_code is None:
        what = " ".join(str(details.message).split())[:300]
        raise InputError(f"{job} did not run ({details.status}): {what}", address, "Give the same command again")
    return int(details.driver_exit_code)


def _unseen(job: str, address: str, why: object) -> InputError:
    """Return the error for a job that goes on but cannot be followed from this machine."""
    follow = f"ray job logs --follow {job} --address {address}"
    remedy = f"Follow the sweep, which goes on: {follow}, or shift3d sweep status OUT"
    return InputError(f"{job} cannot be followed any more ({why})", where=address, remedy=remedy)


def _with_folders(runtime_env: dict[str, Any], folders: Sequence[Path], copies: Path) -> dict[str, Any]:
    """Return the environment with a working directory of copies, which Ray packs and sends on submission."""
    if not folders:
        return runtime_env
    names = " and ".join(folder.name for folder in folders)
    if "working_dir" in runtime_env:
        remedy = f"Copy {names} into that folder and submit from another one, or leave runtime_env.working_dir out"
        raise InputError(f"working_dir is given, and {names} of this folder would travel too", "job=ray_job", remedy)
    for folder in folders:
        shutil.copytree(folder, copies / folder.name)
    return {**runtime_env, "working_dir": str(copies)}


def _submit(address: str, command: str, runtime_env: dict[str, Any] | None) -> tuple[Any, str]:
    from ray.exceptions import RayError

    try:
        from ray.job_submission import JobSubmissionClient

        client = JobSubmissionClient(address)
        return client, str(client.submit_job(entrypoint=command, runtime_env=runtime_env))
    except ImportError as error:
        raise InputError("this installation of Ray cannot submit jobs", where="job=ray_job", remedy=_INSTALL) from error
    except (RayError, RuntimeError, ValueError, OSError) as error:
        what = " ".join(str(error).split())[:300]
        remedy = "Check its address, and that RAY_AUTH_TOKEN_PATH names its token"
        raise InputError(f"the job cannot be submitted: {what}", where=address, remedy=remedy) from error


async def _show(client: Any, job: str) -> None:
    async for lines in client.tail_job_logs(job):
        print(lines, end="", flush=True)
