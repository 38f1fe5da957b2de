"""Launch specs say where a sweep runs and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from shift3d.config.compose import compose_sweep, validate

JOBS = sorted((Path(__file__).resolve().parents[2] / "jobs").glob("*.yaml"))


@pytest.mark.parametrize("path", JOBS, ids=lambda path: path.stem)
def test_a_local_spec_holds_runner_settings_that_a_sweep_takes(path: Path) -> None:
    spec = yaml.safe_load(path.read_text())
    assert set(spec) == {"kind", "runner"}, "no experiment parameter in a launch spec"
    composed = compose_sweep("smoke")
    runner = {**composed.base["runner"], **spec["runner"]}
    assert validate({**composed.base, "runner": runner}, path.name).runner.kind == spec["runner"]["kind"]
