"""Catalogue of hard cases: name, why the case is hard, what must come out, and the safeguard that ensures it.

A case is a function that builds its context and asserts what must hold. A case calls the package and does not read its
source text. `make mutants` shows that the cases need the code: it breaks the code in seeded places and counts the
breaks that a test notices.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

AREAS = (
    "renderer",
    "gradient",
    "loss and IoU",
    "voxelisation",
    "detector",
    "constraints",
    "effects",
    "evaluation",
    "statistics",
    "retrieval",
    "scene files",
    "vehicle files",
    "checkpoints",
    "configuration",
    "sweep",
)
_PATIENCE_S = 20.0


@dataclass(frozen=True)
class HardCase:
    """One context.

    Attributes:
        name: in the field's words. area: one of AREAS.
        why: why it is hard. must: what must come out.
        guard: the safeguard in words.
        check: builds the context and asserts.
    """

    name: str
    area: str
    why: str
    must: str
    guard: str
    check: Callable[[], None]


CASES: dict[str, HardCase] = {}


def hard_case(*, area: str, why: str, must: str, guard: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Add a function without arguments to the catalogue, with its own name in words."""

    def add(check: Callable[[], None]) -> Callable[[], None]:
        name = check.__name__.replace("_", " ")
        assert name not in CASES, f"two hard cases are called {name!r}"
        assert area in AREAS, f"{name}: unknown area {area!r}"
        CASES[name] = HardCase(name, area, why, must, guard, check)
        return check

    return add


class TooLongError(AssertionError):
    """A case did not end in time: an endless search is one kind of failure."""


@contextlib.contextmanager
def patience(seconds: float = _PATIENCE_S) -> Iterator[None]:
    """Raise TooLongError if the body does not end in time."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"not done after {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def table() -> str:
    """Return the catalogue as a Markdown table, by area: case, why it is hard, what must come out, the safeguard."""
    rows = ["| case | why it is hard | what must come out | safeguard |", "|---|---|---|---|"]
    for area in AREAS:
        cases = (case for case in CASES.values() if case.area == area)
        rows += [f"| {area}: {case.name} | {case.why} | {case.must} | {case.guard} |" for case in cases]
    return "\n".join(rows) + "\n"
