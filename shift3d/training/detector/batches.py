"""Training examples, made while the network computes: in a thread beside a CPU, in processes beside a GPU.

One core makes about twenty examples a second.
"""

from __future__ import annotations

import copy
import signal
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Pillars, assign_pillars
from shift3d.detectors.models.network import DetectorNet
from shift3d.processes import process_pool
from shift3d.training.detector.crop_sampling import RandomCrops
from shift3d.training.detector.crops import Crop
from shift3d.training.detector.objective import Objective, map_fields


@dataclass(frozen=True)
class Example:
    """One crop as network input, with its training targets.

    points: (K, 3) float32, network frame, metres; points inside pillars, sorted by pillar. targets: the objective's.
    """

    points: Tensor
    pillars: Pillars
    window: BevWindow
    targets: Any

    def each(self, change: Callable[[Any], Any]) -> Example:
        """Return a copy with `change` applied to every tensor: moved to a device, or converted to an array."""
        pillars, targets = map_fields(self.pillars, change), map_fields(self.targets, change)
        return Example(change(self.points), pillars, self.window, targets)


Batch = tuple[int, list[Example]]
"""Step and its examples, on the CPU."""
AHEAD = 2  # batches that each worker has in progress


class BatchMaker:
    """Maker of the batch of any step; a pickled copy in another process makes the same batches."""

    def __init__(self, crops: RandomCrops, objective: Objective, net: DetectorNet) -> None:
        self.crops, self.objective, self.grid = crops, objective, net.grid
        self.heads = copy.deepcopy(net.heads).cpu()  # training does not change what targets read from the heads

    def of(self, step: int) -> Batch:
        """Return the batch of a step. Raises: InputError if the scenes hold almost no points."""
        return step, [self._example(self.crops.of(step, slot)) for slot in range(self.crops.recipe.batch)]

    def _example(self, crop: Crop) -> Example:
        points = torch.from_numpy(crop.points)
        pillars = assign_pillars(points, self.grid, crop.window)
        in_order = replace(pillars, order=torch.arange(len(pillars.order)))
        targets = self.objective.targets(self.heads, self.grid, crop)
        return Example(points[pillars.order], in_order, crop.window, targets)


def batches(maker: BatchMaker, steps: range, workers: int) -> Iterator[Batch]:
    """Yield the batch of each step, in order. workers: processes that make them; 0: one thread of this process."""
    if workers:
        with process_pool(workers, _open, maker) as pool:
            for step, examples in _in_order(pool, _made_arrays, steps, AHEAD * workers):
                yield step, [example.each(torch.from_numpy) for example in examples]
    else:
        with ThreadPoolExecutor(1) as thread:
            yield from _in_order(thread, maker.of, steps, 1)


def _in_order(pool: Executor, make: Callable[[int], Batch], steps: range, ahead: int) -> Iterator[Batch]:
    """Yield the results of `make` for each step in order, `ahead` of them in progress."""
    coming: deque[Future[Batch]] = deque(pool.submit(make, step) for step in steps[:ahead])
    for step in steps:
        batch = coming.popleft().result()
        if step + ahead in steps:
            coming.append(pool.submit(make, step + ahead))
        yield batch


_maker: BatchMaker | None = None


def _open(maker: BatchMaker) -> None:
    global _maker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process stops the training after a checkpoint
    torch.set_num_threads(1)
    _maker = maker


def _made_arrays(step: int) -> Batch:
    """Return a batch with arrays instead of tensors: each tensor sent to another process holds a file open."""
    assert _maker is not None
    step, examples = _maker.of(step)
    return step, [example.each(torch.Tensor.numpy) for example in examples]
