"""Timing of calls, in an order that spreads the machine's drift over all timed calls."""

from __future__ import annotations

import gc
import os
import platform
import timeit
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any


def milliseconds(call: Callable[[], object]) -> float:
    """Time one call in milliseconds, with the garbage collector disabled."""
    gc.collect()
    return 1e3 * timeit.timeit(call, number=1)


def num_further_timings(first_ms: float, most: int, seconds: float, slow_s: float) -> int:
    """Return the number of further timings of a call: as many as fit into `seconds`, at least 1 and at most `most`.

    first_ms: time of the first run. If the first run exceeds slow_s, the number is 0: the first run is the only timing.
    """
    if first_ms > 1e3 * slow_s:
        return 0
    return max(1, min(most, int(1e3 * seconds / max(first_ms, 1e-6))))


def interleaved_samples(wanted: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """Yield (name, number of the sample) in rounds, so that no name has its samples in a row.

    The largest wanted number decides the number of rounds; smaller numbers of samples spread evenly over the rounds.
    Every second round runs in reverse order, so that a machine that becomes slower or faster affects all names alike.
    """
    rounds = max(wanted.values(), default=0)
    # The i-th of n samples goes to the middle of the i-th of n equal parts.
    when = {name: [int((i + 0.5) * rounds / n) for i in range(n)] for name, n in wanted.items()}
    for number in range(rounds):
        for name in list(wanted)[:: 1 if number % 2 == 0 else -1]:
            if number in when[name]:
                yield name, when[name].index(number)


def machine() -> dict[str, Any]:
    """Describe the machine that times hold for, without a date, so that equal results have equal bytes."""
    import torch

    from shift3d.processor import has_fast_bfloat16

    info = Path("/proc/cpuinfo")
    named = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.is_file() else []
    return {
        "processor": named[0].partition(":")[2].strip() if named else platform.machine(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "fast_bfloat16": has_fast_bfloat16(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "torch": str(torch.__version__),
    }
