"""Launch specs of ``job=NAME``: files of jobs/ that decide where a sweep runs, without effect on results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self

import yaml  # type: ignore[import-untyped]
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from shift3d.cli.command import pop_values
from shift3d.cli.completion import job_names
from shift3d.errors import InputError
from shift3d.settings.folders import files, searched_folders_text


class JobSpec(BaseModel):
    """Launch spec that ``shift3d sweep`` reads. Other tools (Slurm, Kubernetes ...) read the other files of jobs/.

    kind: "local" and "ray_cluster" run the driver on this machine; "ray_job" submits the driver through Ray's Jobs API,
    with ``runtime_env``, to the cluster at ``address``. runner: settings of the runner; the command's settings win.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: Literal["local", "ray_cluster", "ray_job"]
    runner: dict[str, str | int | float | None]
    address: str | None = None
    runtime_env: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.runner.get("kind") not in ("ray", "local"):
            raise ValueError("runner.kind is missing: ray or local")
        if (self.address is None) == (self.kind == "ray_job"):
            raise ValueError("address belongs to a ray_job, and to no other kind")
        return self

    def overrides(self, requested: Sequence[str]) -> list[str]:
        """Return the runner's settings as overrides to put before `requested`; [] if `requested` names a runner."""
        if any(word.startswith("runner=") for word in requested):
            return []
        values = {key: "null" if value is None else value for key, value in self.runner.items() if key != "kind"}
        return [f"runner={self.runner['kind']}", *(f"runner.{key}={value}" for key, value in values.items())]


def pop_job(words: Sequence[str]) -> tuple[JobSpec | None, list[str]]:
    """Split words into the job of the last ``job=`` word and all other words. Raises: InputError, see `read_job`."""
    named, rest = pop_values("job", words)
    return read_job(named[-1]) if named else None, rest


def read_job(name: str) -> JobSpec:
    """Load a launch spec by the name of its file in jobs/ (the current folder's first), or by the path of a file.

    Raises: InputError: the file is missing, unreadable, invalid, or meant for another tool.
    """
    remedy = f"One of: {', '.join(job_names())}, or the path of a file like them. {searched_folders_text('jobs')}"
    named = Path(name).expanduser() if name.endswith((".yaml", ".yml")) else files("jobs").get(name)
    path = named or Path("jobs") / f"{name}.yaml"
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        raise InputError(f"job={name} cannot be read", where=str(path), remedy=remedy) from error
    try:
        return JobSpec.model_validate(values)
    except ValidationError as error:
        if isinstance(values, dict) and values.keys() & {"apiVersion", "cluster_name"}:
            what, remedy = f"job={name} is for another tool", "Use it as its first lines say"
        else:
            first = error.errors()[0]
            what = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {first['msg']}"
        raise InputError(what, where=str(path), remedy=remedy) from error
