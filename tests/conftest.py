"""What every test shares: one thread, fixed seeds, and the folder of real data where there is one."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from pathlib import Path

# One thread: the tests run beside each other, and a task's bytes are defined on one thread.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Every Ray of a session of tests asks for one token, and nothing is written to anybody's home.
os.environ.setdefault("RAY_AUTH_MODE", "token")
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))

import pytest
import torch

torch.set_num_threads(1)

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """``real_data("kitti")`` is that folder of real data beside the repository; the test skips where it is absent."""

    def find(name: str) -> Path:
        root = Path(os.environ.get("SHIFT3D_REAL_DATA", REPOSITORY.parent / "shared" / "real"))
        if not (root / name).is_dir():
            pytest.skip(f"no real data: {root.name}/{name} is absent (SHIFT3D_REAL_DATA names its folder)")
        return root / name

    return find
