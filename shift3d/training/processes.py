"""Parallel map over processes, for work whose result does not depend on the process."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import torch

from shift3d.errors import InputError

Result = TypeVar("Result")


def each(
    work: Callable[..., Result], items: Sequence[Any], workers: int, hold: Callable[[], Any] | None = None
) -> Iterator[Result]:
    """Yield work(item) of each item in order, in this process or in several `workers` with one thread each.

    hold: called once in every process; work is then called as work(held, item). Data sent to other processes must be
    picklable. After an error, items that have not started are cancelled.

    Raises: InputError if a process ends early, as when memory runs out; any error of `work`.
    """
    workers = min(workers, len(items))
    if workers <= 1:
        held = (hold(),) if hold else ()
        yield from (work(*held, item) for item in items)
        return
    # Spawned, not forked: a fork would copy CUDA's state and the locks of this process's threads.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (hold,))
    try:
        yield from pool.map(partial(_with_held, work), items)
    except BrokenProcessPool as error:
        what = f"one of {workers} processes ended early, as when memory runs out"
        raise InputError(what, "this machine", "Give fewer workers= or threads=: the same command resumes") from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Set torch's number of threads while the context is open: results depend on the number bit for bit."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


_held: tuple[Any, ...] = ()


def _begin(hold: Callable[[], Any] | None) -> None:
    global _held
    torch.set_num_threads(1)
    _held = (hold(),) if hold else ()


def _with_held(work: Callable[..., Result], item: Any) -> Result:
    return work(*_held, item)
