"""One MLflow run a gate: its measures, how many objects it lost, and its files."""

from __future__ import annotations

import json
from pathlib import Path

from shift3d.analysis.mlflow.client import attempt, experiment_of, flat, log, open_client, runs_of

__all__ = ["GATE_EXPERIMENT", "mirror_gate"]

GATE_EXPERIMENT = "shift3d-gate"
_FILES = ("verdict.json", "gate.parquet", "gate.html")


def mirror_gate(folder: Path, uri: str) -> str | None:
    """Write the run of a gate's folder; the same suite, weights and release before are one run, written in place.

    Returns None, or why MLflow could not be written.
    """
    return attempt(lambda: _write(folder, uri))


def _write(folder: Path, uri: str) -> None:
    verdict = json.loads((folder / _FILES[0]).read_bytes())
    facts = verdict["facts"]
    key = " ".join(facts[name] for name in ("suite", "detector", "weights", "against", "rule"))
    client = open_client(uri)
    experiment = experiment_of(client, GATE_EXPERIMENT)
    found = runs_of(client, experiment, "shift3d.gate", key, most=1)
    name = f"gate-{facts['detector']}-{facts['weights'][:8]}"
    run = found[0] if found else client.create_run(experiment, run_name=name, tags={"shift3d.gate": key})
    metrics = {"worse": float(verdict["worse"])}
    for measure in verdict["measures"]:
        title = f"{measure['role']}/{measure['name']}"
        metrics |= {f"{title}/{what}": measure[what] for what in ("before", "after", "change", "p_value")}
    metrics |= {f"{role}/lost": counts["lost"] for role, counts in verdict["objects"].items()}
    points = [(metric, value, 0) for metric, value in metrics.items()]
    log(client, run.info.run_id, points, run.info.start_time, flat(facts))
    for file in _FILES:
        client.log_artifact(run.info.run_id, str(folder / file))
    client.set_terminated(run.info.run_id, "FINISHED")
