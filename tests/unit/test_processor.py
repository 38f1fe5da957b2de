"""What a process computes with: its threads, how much of the code that oneDNN makes it keeps, and its pages."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from shift3d.processor import usable_cpus

# Grows by what 700 products of different sizes leave behind, configured before or not, torch imported before or not.
PRODUCTS = """
import ctypes, json, os, sys
early, configured = sys.argv[1] == "early", sys.argv[2] == "configured"
if early:
    import torch
if configured:
    from shift3d.processor import configure_runtime
    configure_runtime(1)
import torch

def product(rows):
    torch.ops.mkldnn._linear_pointwise(torch.ones(rows, 256), weight, None, "none", [], "")

def resident_mb():
    ctypes.CDLL(None).malloc_trim(0)  # as a worker does
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

weight = torch.ones(256, 256)
with torch.no_grad():
    product(1)
    before = resident_mb()
    for rows in range(2, 702):
        product(rows)
print(json.dumps({"grown_mb": resident_mb() - before, "threads": torch.get_num_threads()}))
"""

# How much of a large tensor lies in large pages.
PAGES = """
import sys
if sys.argv[1] == "early":
    import torch
from shift3d.processor import configure_runtime
configure_runtime(1)
import torch
tensor = torch.ones(64 * 2**18)
lines = open("/proc/self/smaps_rollup").read().splitlines()
print(next(line.split()[1] for line in lines if line.startswith("AnonHugePages")))
"""
LARGE_PAGES = Path("/sys/kernel/mm/transparent_hugepage/enabled")

takes_onednn = pytest.mark.skipif(
    not (torch.backends.mkldnn.is_available() and torch.backends.cpu.get_cpu_capability().startswith("AVX512"))
    or platform.libc_ver()[0] != "glibc",
    reason="oneDNN is not used on this processor, or the allocator is not glibc's",
)


def products(*how: str, **environment: str) -> dict[str, float]:
    unset = {name: value for name, value in os.environ.items() if "CACHE_CAPACITY" not in name}
    command = [sys.executable, "-c", PRODUCTS, *how]
    done = subprocess.run(command, env=unset | environment, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def without() -> dict[str, float]:
    """Of a process that was not configured: when it imports torch makes no difference to it."""
    return products("late", "as it is")


@takes_onednn
@pytest.mark.parametrize("torch_imported", ["early", "late"])
def test_code_that_is_made_does_not_pile_up(torch_imported: str, without: dict[str, float]) -> None:
    configured = products(torch_imported, "configured")
    assert configured["grown_mb"] < 0.5 * without["grown_mb"], (configured, without)
    assert configured["threads"] == 1


@takes_onednn
def test_what_the_environment_says_is_left_as_it_is(without: dict[str, float]) -> None:
    settings = {"ONEDNN_PRIMITIVE_CACHE_CAPACITY": "1024", "LRU_CACHE_CAPACITY": "1024"}
    assert products("late", "configured", **settings)["grown_mb"] > 0.8 * without["grown_mb"]


def large_pages_kb(torch_imported: str, **environment: str) -> int:
    unset = {name: value for name, value in os.environ.items() if name != "THP_MEM_ALLOC_ENABLE"}
    command = [sys.executable, "-c", PAGES, torch_imported]
    done = subprocess.run(command, env=unset | environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.fixture(scope="module")
def small_pages_kb() -> int:
    return large_pages_kb("late", THP_MEM_ALLOC_ENABLE="0")


@pytest.mark.skipif(
    not LARGE_PAGES.exists() or "[madvise]" not in LARGE_PAGES.read_text(), reason="this kernel gives all or none"
)
@pytest.mark.parametrize("torch_imported", ["early", "late"])
def test_large_tensors_lie_in_large_pages(torch_imported: str, small_pages_kb: int) -> None:
    # Half of the 64 MB: what of a tensor is not on a page's border, and what the kernel has left, may not.
    assert large_pages_kb(torch_imported) > small_pages_kb + 32 * 1024


@pytest.mark.parametrize(
    ("files", "cpus"),
    [
        ({}, 6),
        ({"cpu.max": "max 100000\n"}, 6),
        ({"cpu.max": "250000 100000\n"}, 3),
        ({"cpu.max": "10000 100000\n"}, 1),
        ({"cpu.max": "1600000 100000\n"}, 6),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 6),
        ({"cpu/cpu.cfs_quota_us": "200000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 2),
    ],
)
def test_cpus_are_those_that_this_process_may_use(
    files: dict[str, str], cpus: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)), raising=False)
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert usable_cpus(tmp_path) == cpus
