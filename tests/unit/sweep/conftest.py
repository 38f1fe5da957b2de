"""Plans shared by tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from by_hand import BOTH_LAMBDAS, catalogue

from shift3d.settings.compose import compose_sweep
from shift3d.sweep.planning.plan import Plan, make_plan


@pytest.fixture(scope="session")
def default_plan() -> Plan:
    return make_plan(compose_sweep("default", BOTH_LAMBDAS), catalogue)[0]


@pytest.fixture(scope="session")
def suv_plan() -> Plan:
    """suv in two scenes: shape with lambda 1 and 10, pose."""
    return make_plan(compose_sweep("default", [*BOTH_LAMBDAS, "vehicle=suv"]), catalogue)[0]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"
