"""The meshes of a finished sweep's solutions, measured."""

from __future__ import annotations

from shift3d.settings.schema.config import LocalRunnerConfig, RayRunnerConfig
from shift3d.store.resolve import LocationLike, as_location
from shift3d.sweep.drive import SweepResult
from shift3d.sweep.follow_up import follow_up
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.verification import verification_plan


def patterns_kind() -> TaskKind:
    """A task that measures another one's meshes."""
    from shift3d.settings.catalogue.reading import read_catalogue
    from shift3d.task.follow_ups.patterns import patterns_task
    from shift3d.task.follow_ups.verify import load_verify_assets

    return TaskKind(run=patterns_task, load=load_verify_assets, catalogue=read_catalogue, single=False)


def measure_patterns(folder: LocationLike, runner: RayRunnerConfig | LocalRunnerConfig) -> SweepResult:
    """Measure what is left of a finished sweep's solutions, and write ``final/patterns.parquet``.

    Raises: InputError as `follow_up` and `verification_plan`.
    """
    folder = as_location(folder)
    return follow_up(folder, verification_plan(folder), runner, patterns_kind(), folder / "patterns", "patterns")
