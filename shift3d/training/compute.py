"""Device and arithmetic of a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import torch

from shift3d.errors import InputError
from shift3d.processor import has_fast_bfloat16, usable_cpus

DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class Compute:
    """Device, and number of CPU threads.

    The same number of threads gives the same bytes on the CPU. On CUDA the order of sums may differ from run to run.
    Tests of the CUDA path are skipped on machines without CUDA.
    """

    device: torch.device
    threads: int = 1

    @property
    def name(self) -> str:
        """Name of the device: "cpu", or the name that CUDA reports."""
        return torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else "cpu"

    @property
    def fast_bfloat16(self) -> bool:
        """True if mixed precision saves time: on CUDA, or on a processor with bfloat16 multiplication."""
        return self.device.type == "cuda" or has_fast_bfloat16()

    @property
    def scene_workers(self) -> int:
        """Number of processes that make the scenes before the network trains."""
        return self.threads if self.device.type == "cpu" else usable_cpus()

    @property
    def crop_workers(self) -> int:
        """Number of processes that make crops while the network trains; 0 on a CPU, where one thread keeps up."""
        return 0 if self.device.type == "cpu" else max(1, usable_cpus() - 1)

    def autocast(self, wanted: bool) -> torch.autocast:
        """Return a context that computes large products in bfloat16 if `wanted` and if bfloat16 saves time."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=wanted and self.fast_bfloat16)

    def prepare(self) -> None:
        """Set torch's global switches: threads, deterministic kernels, and subnormal numbers flushed to zero.

        Dead units leave subnormal weights, whose products are several times slower. Flushing changes the results.
        """
        torch.set_num_threads(self.threads)
        torch.set_flush_denormal(True)
        if self.device.type == "cuda":
            torch.backends.cudnn.deterministic = True
            torch.backends.cudnn.benchmark = False

    def facts(self, bfloat16: bool) -> dict[str, str | int | bool]:
        """Return the settings that change the resulting bytes, for a provenance file."""
        mixed = bfloat16 and self.fast_bfloat16
        return {"device": self.name, "threads": self.threads, "mixed_bfloat16": mixed, "flush_denormal": True}


@contextmanager
def restore_subnormals() -> Iterator[None]:
    """Restore torch's handling of subnormal numbers afterwards: a training flushes them to zero."""
    kept = bool(torch.tensor([1e-310], dtype=torch.float64).mul(1.0).any())
    try:
        yield
    finally:
        torch.set_flush_denormal(not kept)


ONE_THREAD = Compute(torch.device("cpu"))  # the default of all trainings


def choose_compute(device: Literal["auto", "cpu", "cuda"] | str = "auto", threads: int = 1) -> Compute:
    """Return the device of a name; auto selects CUDA if the machine has a CUDA device.

    Raises: InputError for an unknown name, or for cuda without a CUDA device.
    """
    if device not in DEVICES:
        raise InputError(f"unknown device {device!r}", where="device=", remedy=f"Choose from {', '.join(DEVICES)}")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("this torch finds no CUDA device", where="device=cuda", remedy="Give device=cpu or auto")
    on_cuda = device == "cuda" or (device == "auto" and torch.cuda.is_available())
    return Compute(torch.device("cuda" if on_cuda else "cpu"), threads)
