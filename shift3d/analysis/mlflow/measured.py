"""One MLflow run a measurement that is a folder: its numbers, and its files."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.analysis.mlflow.client import attempt, experiment_of, flat, log, open_client, runs_of
from shift3d.errors import InputError


def mirror_measured(
    kind: str,
    folder: Path,
    files: Sequence[str],
    metrics: Mapping[str, float],
    params: Mapping[str, Any],
    uri: str,
    experiment: str,
) -> str | None:
    """Write the run "<kind>-<hash of the first file>", or write it again in place.

    Another measurement is another run, so that they can be compared, and the same folder mirrored twice is one.

    Args:
        files: of the folder, which become artifacts; the first is the measured table.
        params: nested plain values. uri, experiment: of the store.
    Returns:
        None, or why MLflow could not be written.
    """

    def write() -> None:
        # Before anything is written: half a run would look like a whole one.
        missing = [name for name in files if not (folder / name).is_file()]
        if missing:
            raise InputError(f"{missing[0]} is missing", str(folder), f"Write the report of the {kind} first")
        key = hashlib.blake2b((folder / files[0]).read_bytes(), digest_size=8).hexdigest()
        client = open_client(uri)
        experiment_id = experiment_of(client, experiment)
        found = runs_of(client, experiment_id, f"shift3d.{kind}", key, most=1)
        tags = {f"shift3d.{kind}": key, "shift3d.folder": str(folder)}
        run = found[0] if found else client.create_run(experiment_id, run_name=f"{kind}-{key}", tags=tags)
        points = [(name, value, 0) for name, value in metrics.items()]
        log(client, run.info.run_id, points, run.info.start_time, flat(params))
        for name in files:
            client.log_artifact(run.info.run_id, str(folder / name))
        client.set_terminated(run.info.run_id, "FINISHED")

    return attempt(write)
