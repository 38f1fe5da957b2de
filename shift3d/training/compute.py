"""Where a training computes, and with what arithmetic."""

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
    """A device, and the threads of its arithmetic on the CPU.

    On the CPU a training gives the same bytes again for the same threads; on CUDA sums may be taken in another order
    from run to run. Tests of the CUDA path are skipped where there is no CUDA.
    """

    device: torch.device
    threads: int = 1

    @property
    def name(self) -> str:
        """ "cpu", or what CUDA calls the device."""
        return torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else "cpu"

    @property
    def fast_bfloat16(self) -> bool:
        """Whether mixed precision pays: CUDA, or a processor that multiplies bfloat16 by itself."""
        return self.device.type == "cuda" or has_fast_bfloat16()

    @property
    def scene_workers(self) -> int:
        """Processes that make the scenes, before the network trains."""
        return self.threads if self.device.type == "cpu" else usable_cpus()

    @property
    def crop_workers(self) -> int:
        """Processes that make crops while the network trains; 0: a thread keeps up, as on a CPU."""
        return 0 if self.device.type == "cpu" else max(1, usable_cpus() - 1)

    def autocast(self, wanted: bool) -> torch.autocast:
        """bfloat16 for large products where it is wanted and pays."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=wanted and self.fast_bfloat16)

    def prepare(self) -> None:
        """Set torch's global switches: threads, deterministic kernels, and no subnormal numbers.

        Units that die leave subnormal weights, whose products are several times slower; flushing them changes bytes.
        """
        torch.set_num_threads(self.threads)
        torch.set_flush_denormal(True)
        if self.device.type == "cuda":
            torch.backends.cudnn.deterministic = True
            torch.backends.cudnn.benchmark = False

    def facts(self, bfloat16: bool) -> dict[str, str | int | bool]:
        """What of this changes bytes, for a provenance file."""
        mixed = bfloat16 and self.fast_bfloat16
        return {"device": self.name, "threads": self.threads, "mixed_bfloat16": mixed, "flush_denormal": True}


@contextmanager
def subnormals_as_before() -> Iterator[None]:
    """A training flushes subnormal numbers to zero: whatever computes afterwards has those again that it had."""
    kept = bool(torch.tensor([1e-310], dtype=torch.float64).mul(1.0).any())
    try:
        yield
    finally:
        torch.set_flush_denormal(not kept)


ONE_THREAD = Compute(torch.device("cpu"))
"""What trainings compute on where nothing else is given."""


def choose_compute(device: Literal["auto", "cpu", "cuda"] | str = "auto", threads: int = 1) -> Compute:
    """The device by name; auto is CUDA where there is one.

    Raises: InputError for an unknown name, or cuda where there is none.
    """
    if device not in DEVICES:
        raise InputError(f"unknown device {device!r}", where="device=", remedy=f"Choose from {', '.join(DEVICES)}")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("this torch finds no CUDA device", where="device=cuda", remedy="Give device=cpu or auto")
    on_cuda = device == "cuda" or (device == "auto" and torch.cuda.is_available())
    return Compute(torch.device("cuda" if on_cuda else "cpu"), threads)
