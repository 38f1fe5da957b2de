"""Memory that a task has freed goes back to the system."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest
import torch

from shift3d.sweep.execution import worker


def resident_mb() -> float:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another allocator than glibc's")
def test_a_heap_full_of_holes_is_given_back() -> None:
    """Every hundredth of many small tensors stays: the allocator alone keeps the pages between them."""
    kept = [torch.ones(25_000) for _ in range(3000)][::100]  # 100 kB each, 300 MB
    before = resident_mb()
    worker._release_free_memory()
    assert resident_mb() < before - 100
    assert all(float(part.sum()) == 25_000 for part in kept)
