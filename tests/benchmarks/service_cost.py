"""The load that one driver can feed: cost of a sweep on many workers, computed from measured parts.

It is a model, not a measurement: it names the part that saturates first, and at which task length. Source: our choice.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Forecast", "Parts", "forecast", "forecast_lines"]


@dataclass(frozen=True)
class Parts:
    """Times of the parts, measured on one machine.

    overhead_us: the service's total time per no-op task. commit_ms: a durable commit of 1,000 rows. call_us: a call to
    a worker and its answer. transfer_mb_s: weights into the object store and a worker. weights_mb: weights that a
    worker loads, 10^6 bytes. task_s: one real task.
    """

    overhead_us: float
    commit_ms: float
    call_us: float
    transfer_mb_s: float
    weights_mb: float
    task_s: float


@dataclass(frozen=True)
class Forecast:
    """A sweep of ``tasks`` on ``workers``.

    hours: duration if no part is a bottleneck. busy: part to its share of the driver's time; the driver keeps up while
    the sum is below 1. weights_s: time until every worker has its weights, sent one after the other from one machine.
    bottleneck: the part with the largest share. shortest_task_s: with shorter tasks the driver would not keep the
    workers busy.
    """

    workers: int
    tasks: int
    hours: float
    busy: dict[str, float]
    weights_s: float
    bottleneck: str
    shortest_task_s: float


def forecast(parts: Parts, workers: int, tasks: int, batch_s: float = 3.0, commit_s: float = 2.0) -> Forecast:
    """Extrapolate from the parts. batch_s: work per call to a worker. commit_s: time between commits.

    A commit's fixed cost is counted as its whole time, and its rows once more within the overhead of a task: the model
    errs towards too much work for the driver.

    Raises:
        ValueError: a part, the workers or the tasks are not positive.
    """
    if min(parts.overhead_us, parts.commit_ms, parts.call_us, parts.transfer_mb_s, parts.task_s, workers, tasks) <= 0:
        raise ValueError("a cost model needs positive parts, workers and tasks")
    calls_a_second = workers / max(batch_s, parts.task_s)
    busy = {
        "rows of tasks": workers / parts.task_s * parts.overhead_us * 1e-6,
        "commits": parts.commit_ms * 1e-3 / commit_s,
        "calls to workers": calls_a_second * parts.call_us * 1e-6,
    }
    # If tasks are so short that a batch holds many, only the number of rows grows with the number of tasks.
    rest = busy["commits"] + workers / batch_s * parts.call_us * 1e-6
    shortest = workers * parts.overhead_us * 1e-6 / (1 - rest) if rest < 1 else float("inf")
    return Forecast(
        workers=workers,
        tasks=tasks,
        hours=tasks * parts.task_s / workers / 3600,
        busy=busy,
        weights_s=workers * parts.weights_mb / parts.transfer_mb_s,
        bottleneck=max(busy, key=lambda name: busy[name]),
        shortest_task_s=shortest,
    )


def forecast_lines(found: Forecast) -> str:
    """Format the forecast in a few lines."""
    shares = ", ".join(f"{name} {100 * share:.2g} %" for name, share in found.busy.items())
    return (
        f"{found.tasks:.0e} tasks on {found.workers:,} workers: {found.hours:,.1f} h; of the driver's time: {shares}\n"
        f"first bottleneck: {found.bottleneck}; it keeps {found.workers:,} workers busy down to tasks of "
        f"{found.shortest_task_s:.2g} s\n"
        f"weights reach the last worker after at most {found.weights_s:,.0f} s"
    )
