"""Work that is the same whichever process does it, spread over several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import torch

Result = TypeVar("Result")


def each(
    work: Callable[..., Result], items: Sequence[Any], workers: int, hold: Callable[[], Any] | None = None
) -> Iterator[Result]:
    """work(item) of each item, in order, over processes if there are several, each with one thread.

    hold: called once in every process; work is then work(held, item). What goes to another process must be picklable.
    What has not begun is left out on an error.
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
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many threads for what is computed while this is open: the bits depend on it."""
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
