"""A second pool replaces the first one in a sweep's tables only together with its results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import valid_sweeps

from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import LocalRunnerConfig
from shift3d.store.log_entries import read_log
from shift3d.sweep import retrieval
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.results.final import write_final

LOCAL = LocalRunnerConfig(kind="local", commit_seconds=0.0, abort_after=None, abort_share=None)


ONE = ["vehicle=suv", "mode=shape"]


def made_by(pool: Path) -> bytes:
    return f"kin of {pool.name}".encode()


def test_kin_of_the_pool_before_are_not_left_beside_another_pool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, first, second = (tmp_path / name for name in ("sweep", "first", "second"))
    for part in (folder, first, second):
        valid_sweeps.write_sweep(part)
        write_final(part, valid_sweeps.plan(), read_log(part))
    for pool in (first, second):
        (pool / "final" / "vehicle_pool.parquet").write_bytes(pool.name.encode())
    kin, kept = folder / "final" / "retrieved.parquet", folder / "final" / "vehicle_pool.parquet"

    def whole(*_: Any) -> None:
        kin.write_bytes(made_by(first))

    def broken_off(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(retrieval, "follow_up", whole)
    retrieval.retrieve(folder, first, LOCAL)
    monkeypatch.setattr(retrieval, "follow_up", broken_off)
    for pool, kin_stay in ((first, True), (second, False)):
        with pytest.raises(KeyboardInterrupt):
            retrieval.retrieve(folder, pool, LOCAL)
        assert kept.read_bytes() == pool.name.encode() and kin.is_file() == kin_stay


def test_a_pool_of_another_detector_than_the_attacked_one_is_said() -> None:
    plans = [make_plan(compose_sweep("smoke", [*ONE, f"detector={name}"]), valid_sweeps.catalogue)[0]
             for name in ("sst", "pointpillars")]  # fmt: skip
    note = retrieval.other_detector(*plans)
    assert note == "pointpillars scores the vehicles in the log; the sweep attacked sst: give detector=sst"
    assert retrieval.other_detector(plans[0], plans[0]) is None
