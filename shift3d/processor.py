"""What the processor does well, for choices that change time and not results that are compared."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import platform
import sys
from pathlib import Path

__all__ = ["configure_runtime", "has_fast_bfloat16", "has_wide_float32", "pad_to_bucket", "rounding", "usable_cpus"]

_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# oneDNN's own products, and what torch keeps of how each is to be made; and large pages for large tensors.
_SETTINGS = {"ONEDNN_PRIMITIVE_CACHE_CAPACITY": "256", "LRU_CACHE_CAPACITY": "256", "THP_MEM_ALLOC_ENABLE": "1"}


def configure_runtime(threads: int = 1) -> None:
    """Fix what this process computes with, before it computes: threads, how much made code it keeps, and its pages.

    The order of sums, so the bytes, depend on the number of threads.

    oneDNN keeps code and plans for 1,024 products unless told otherwise, up to a megabyte each: a worker had grown to
    2.5 GB after fifty shape attacks. With 256 six of them take as long (103 s for 104) and 0.5 GB less, with 128 107 s.

    Tensors of 2 MB and more ask Linux for pages of that size. A step makes and drops hundreds of megabytes, and in
    pages of 4 kB each has to be fetched from the kernel, which in a virtual machine can take microseconds: four tasks
    took 28.1 s for 29.4, at 1.16 GB for 1.26.

    What the environment says of these is left as it is; the number of threads is replaced.
    """
    for name in _THREADS:
        os.environ[name] = str(threads)
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def usable_cpus(cgroup: Path = Path("/sys/fs/cgroup")) -> int:
    """CPUs that this process may use: those of its affinity, at most the CPU quota of its control group, rounded up."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):  # versions 2 and 1
        with contextlib.suppress(OSError, ValueError):  # there is no such file, or it says "max"
            quota, period = (int(word) for name in names for word in (cgroup / name).read_text().split())
            if quota > 0:
                return max(1, min(allowed, math.ceil(quota / period)))
    return allowed


@functools.cache
def has_fast_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 matrices with instructions of its own.

    Where it has none they are emulated, some sixty times slower than float32 (measured: 1.2 against 70 GFLOP/s on
    one core with AVX2 alone), so that every use of bfloat16 on CPU asks here first.
    """
    import torch

    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


@functools.cache
def has_wide_float32() -> bool:
    """Whether oneDNN is to be asked for float32 products of matrices, in place of torch's default.

    torch leaves them to MKL, which uses half the width of AVX-512 on processors that are not Intel's: 90 against 200
    GFLOP/s on one core (AMD, 600 rows by 512 x 512). On Intel's both use the whole width, and MKL starts faster: 8 rows
    by 352 x 352 take 0.05 ms for 0.09, 64 rows 0.14 for 0.17, 500 rows the same.
    """
    import torch

    wide = torch.backends.cpu.get_cpu_capability().startswith("AVX512")
    wide_mkl = torch.backends.mkl.is_available() and "Intel" in str(torch.cpu.get_capabilities().get("cpu_name"))
    onednn = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    return wide and onednn and not wide_mkl


def pad_to_bucket(rows: int) -> int:
    """The next number of rows, from this one up, that comes round again: for products that oneDNN takes.

    It makes code for every number of rows that it meets, at half a millisecond and up to half a megabyte a product: as
    long as a product of 300 rows by 512 x 512 takes. A search evaluates what is left of its beams, another number each
    time, and of the time of a short attack 7 % went there. Two numbers an octave are soon all known; from 256 rows on,
    multiples of 128.
    """
    if rows <= 16:
        return 16 if rows else 0
    octave = 1 << (rows - 1).bit_length() - 1
    step = max(octave // 2, 16) if rows <= 256 else 128
    return -(-rows // step) * step


def rounding() -> tuple[str | bool | int, ...]:
    """What decides how results round here: machines that share a home folder may differ in it."""
    import torch

    capability, threads = torch.backends.cpu.get_cpu_capability(), torch.get_num_threads()
    return platform.node(), torch.__version__, capability, has_fast_bfloat16(), threads
