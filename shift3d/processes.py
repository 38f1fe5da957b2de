"""Parallel map over processes, for work whose result does not depend on the process.

torch is imported where it is used: processes that need none start a second earlier.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from shift3d.errors import InputError

Result = TypeVar("Result")


@contextmanager
def process_pool(
    workers: int, begin: Callable[..., None] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Open processes that share work and end with this process, even if it is killed.

    begin: called as begin(*arguments) once in every process. What is sent to processes must be picklable. On leaving,
    calls that have not started are cancelled.

    Raises: InputError if a process ends early, as when memory runs out.
    """
    # Spawned, not forked: a fork would copy CUDA's state and the locks of this process's threads.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (begin, arguments))
    try:
        yield pool
    except BrokenProcessPool as error:
        what = f"one of {workers} processes ended early, as when memory runs out"
        raise InputError(what, "this machine", "Give fewer workers= or threads=: the same command resumes") from error
    finally:
        pool.shutdown(cancel_futures=True)


def each(
    work: Callable[..., Result], items: Sequence[Any], workers: int, hold: Callable[[], Any] | None = None
) -> Iterator[Result]:
    """Yield work(item) of each item in order, in this process or in several `workers` with one torch thread each.

    hold: called once in every process; work is then called as work(held, item). See `process_pool`.

    Raises: InputError if a process ends early; any error of `work`.
    """
    workers = min(workers, len(items))
    if workers <= 1:
        held = (hold(),) if hold else ()
        yield from (work(*held, item) for item in items)
        return
    with process_pool(workers, _hold, hold) as pool:
        yield from pool.map(partial(_with_held, work), items)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Set torch's number of threads while the context is open: results depend on the number bit for bit."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


_held: tuple[Any, ...] = ()


def _begin(begin: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if begin:
        begin(*arguments)


def _end_with_parent() -> None:
    """End this process when its parent has ended: the pool's queues stay open in its siblings, so no read fails."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _hold(hold: Callable[[], Any] | None) -> None:
    global _held
    import torch

    torch.set_num_threads(1)
    _held = (hold(),) if hold else ()


def _with_held(work: Callable[..., Result], item: Any) -> Result:
    return work(*_held, item)
