"""Processor features and runtime settings, for choices that change run time but no compared result."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import platform
import sys
from pathlib import Path

__all__ = [
    "configure_runtime",
    "has_fast_bfloat16",
    "instructions",
    "mixed_processors",
    "onednn_float32_is_faster",
    "pad_to_bucket",
    "rounding",
    "usable_cpus",
]

_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# Capacities of the primitive caches of oneDNN and torch; large memory pages for large tensors.
_SETTINGS = {"ONEDNN_PRIMITIVE_CACHE_CAPACITY": "256", "LRU_CACHE_CAPACITY": "256", "THP_MEM_ALLOC_ENABLE": "1"}


def configure_runtime(threads: int = 1) -> None:
    """Set the number of threads, the oneDNN cache capacity and the page size of this process, before it computes.

    The number of threads decides the order of floating-point sums and therefore the bytes of results.

    oneDNN's default caches code for 1,024 matrix products, up to a megabyte each: a worker grew to 2.5 GB over fifty
    shape attacks. With 256, six attacks take as long (103 s, default 104 s) and 0.5 GB less; with 128 they take 107 s.

    Tensors of at least 2 MB request pages of 2 MB from Linux. An attack step allocates hundreds of megabytes, and each
    page of 4 kB costs a page fault, which can take microseconds in a virtual machine. Four tasks took 28.1 s and
    1.16 GB with large pages, 29.4 s and 1.26 GB without.

    Environment variables that already set the caches or pages keep their values. The number of threads is replaced.
    """
    for name in _THREADS:
        os.environ[name] = str(threads)
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def usable_cpus(cgroup: Path = Path("/sys/fs/cgroup")) -> int:
    """Count the CPUs in this process's affinity mask, limited to the CPU quota of its control group, rounded up."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):  # versions 2 and 1
        with contextlib.suppress(OSError, ValueError):  # there is no such file, or it says "max"
            quota, period = (int(word) for name in names for word in (cgroup / name).read_text().split())
            if quota > 0:
                return max(1, min(allowed, math.ceil(quota / period)))
    return allowed


@functools.cache
def has_fast_bfloat16() -> bool:
    """True if this processor has instructions for products of bfloat16 matrices.

    Emulated bfloat16 is about sixty times slower than float32 (measured: 1.2 against 70 GFLOP/s on one core with AVX2
    alone). Code checks this on its own machine before it uses bfloat16, except for the detector of a search: its
    precision is part of the plan, which the driver makes for its own processor.
    """
    import torch

    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def instructions() -> str:
    """Describe the instructions that decide rounding on this processor, such as "AVX512 with bfloat16"."""
    import torch

    return f"{torch.backends.cpu.get_cpu_capability()} {'with' if has_fast_bfloat16() else 'without'} bfloat16"


def mixed_processors(one: str, other: str) -> str:
    """Return the line for a sweep on processors that round differently. one, other: "HOST computes with ..."."""
    return (
        f"{one}, {other}: their results differ in the last digits, so the tables depend on which machine runs which "
        "task. For equal bytes, run the sweep on processors of one kind"
    )


@functools.cache
def onednn_float32_is_faster() -> bool:
    """True if oneDNN computes float32 matrix products faster than MKL, torch's default.

    On processors of other vendors than Intel, MKL uses half the width of AVX-512: 90 GFLOP/s, oneDNN 200 GFLOP/s (one
    core, AMD, 600 rows by 512 x 512). On Intel processors both use the full width, and MKL starts faster: 8 rows by
    352 x 352 take 0.05 ms with MKL and 0.09 ms with oneDNN, 64 rows 0.14 and 0.17 ms, 500 rows the same.
    """
    import torch

    wide = torch.backends.cpu.get_cpu_capability().startswith("AVX512")
    wide_mkl = torch.backends.mkl.is_available() and "Intel" in str(torch.cpu.get_capabilities().get("cpu_name"))
    onednn = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    return wide and onednn and not wide_mkl


def pad_to_bucket(rows: int) -> int:
    """Round a number of rows up to a bucket size, so that oneDNN reuses its generated code.

    oneDNN generates code for every new number of rows, in half a millisecond and up to half a megabyte per product: as
    long as a product of 300 rows by 512 x 512. The number of remaining beams changes in every iteration of the root
    search: code generation took 7 % of a short attack. Up to 256 rows an octave has two sizes, then multiples of 128.
    """
    if rows <= 16:
        return 16 if rows else 0
    octave = 1 << (rows - 1).bit_length() - 1
    step = max(octave // 2, 16) if rows <= 256 else 128
    return -(-rows // step) * step


def rounding() -> tuple[str | bool | int, ...]:
    """Return the facts that decide rounding, as part of cache keys: machines that share a home folder may differ."""
    import torch

    capability, threads = torch.backends.cpu.get_cpu_capability(), torch.get_num_threads()
    return platform.node(), torch.__version__, capability, has_fast_bfloat16(), threads
