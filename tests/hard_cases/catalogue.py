"""The catalogue of hard cases: what each one is, what must come out, and which safeguard of the code it stands on.

A case is a function that builds its situation and asserts what must hold. With it goes its safeguard: the few words
of the code that make it hold, and what they would read without it. A test runs every case as the code is, and once
more with its safeguard taken out, where it must fail: a case that no line of code is needed for proves nothing.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import inspect
import signal
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType, FrameType, FunctionType

AREAS = (
    "renderer",
    "gradient",
    "loss and IoU",
    "voxelisation",
    "detector",
    "constraints",
    "effects",
    "evaluation",
    "scene files",
    "vehicle files",
    "checkpoints",
    "configuration",
    "sweep",
)
_PATIENCE_S = 20.0


@dataclass(frozen=True)
class Edit:
    """A safeguard taken out of the source: `before` occurs once in `module` and is replaced by `after`.

    Both lie inside functions: what a module computes once, on import, is not run again.
    """

    module: str
    before: str
    after: str


@dataclass(frozen=True)
class HardCase:
    """One situation.

    Attributes:
        name: in the field's words. area: one of AREAS.
        why: why it is hard. must: what must come out.
        guard: the safeguard in words. edits: how it is taken out.
        check: builds the situation and asserts.
    """

    name: str
    area: str
    why: str
    must: str
    guard: str
    edits: tuple[Edit, ...]
    check: Callable[[], None]


CASES: dict[str, HardCase] = {}


def hard_case(
    *, area: str, why: str, must: str, guard: str, edits: Edit | tuple[Edit, ...]
) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Put a function without arguments into the catalogue, under its own name in words."""

    def add(check: Callable[[], None]) -> Callable[[], None]:
        name = check.__name__.replace("_", " ")
        assert name not in CASES, f"two hard cases are called {name!r}"
        assert area in AREAS, f"{name}: unknown area {area!r}"
        CASES[name] = HardCase(name, area, why, must, guard, edits if isinstance(edits, tuple) else (edits,), check)
        return check

    return add


@contextlib.contextmanager
def without(edits: tuple[Edit, ...]) -> Iterator[None]:
    """Run with some words of the source replaced: every function that they change gets its new code, and back.

    Raises:
        AssertionError: the words are not in the source, occur twice, or change no function: the safeguard has moved.
    """
    swapped: list[tuple[FunctionType, CodeType]] = []
    try:
        # Effects are imported when a scene calls for them: what is not there yet has no functions to change.
        for edit in edits:
            importlib.import_module(edit.module)
        functions = [thing for thing in gc.get_objects() if isinstance(thing, FunctionType)]
        for module in dict.fromkeys(edit.module for edit in edits):
            for function, code in _changed(module, [edit for edit in edits if edit.module == module], functions):
                swapped.append((function, function.__code__))
                function.__code__ = code
        yield
    finally:
        for function, code in reversed(swapped):
            function.__code__ = code


def _changed(name: str, edits: list[Edit], functions: list[FunctionType]) -> list[tuple[FunctionType, CodeType]]:
    module = sys.modules[name]
    source, path = inspect.getsource(module), inspect.getsourcefile(module)
    edited = source
    for edit in edits:
        count = edited.count(edit.before)
        assert count == 1, f"{name} holds {edit.before!r} {count} times, not once: the safeguard has moved"
        edited = edited.replace(edit.before, edit.after)
    assert path is not None
    old = dict(_codes(compile(source, path, "exec", dont_inherit=True)))
    new = dict(_codes(compile(edited, path, "exec", dont_inherit=True)))
    assert old.keys() == new.keys(), f"{name}: an edit adds or removes a function"
    pairs = [
        (function, new[key])
        for function in functions
        if function.__code__.co_filename == path
        and (key := function.__code__.co_qualname) in new
        and not _same(old[key], new[key])
    ]
    assert pairs, f"{name}: {[edit.before for edit in edits]} is in no function that is in use"
    return pairs


def _codes(code: CodeType) -> Iterator[tuple[str, CodeType]]:
    """Every function of a compiled module by its qualified name; of two with one name the last, as Python has it."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant.co_qualname, constant
            yield from _codes(constant)


def _same(a: CodeType, b: CodeType) -> bool:
    """Equal but for line numbers."""
    if (a.co_code, a.co_names, a.co_varnames, a.co_freevars) != (b.co_code, b.co_names, b.co_varnames, b.co_freevars):
        return False
    return len(a.co_consts) == len(b.co_consts) and all(
        _same(x, y)
        if isinstance(x, types.CodeType) and isinstance(y, types.CodeType)
        else type(x) is type(y) and repr(x) == repr(y)
        for x, y in zip(a.co_consts, b.co_consts, strict=True)
    )


class TooLongError(AssertionError):
    """A case did not end: without a safeguard that is one way to fail."""


@contextlib.contextmanager
def patience(seconds: float = _PATIENCE_S) -> Iterator[None]:
    """Raise TooLongError where the body does not end in time."""

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
    """The catalogue as a Markdown table, by area: case, why it is hard, what must come out, the safeguard."""
    rows = ["| case | why it is hard | what must come out | safeguard | where |", "|---|---|---|---|---|"]
    for area in AREAS:
        for case in (c for c in CASES.values() if c.area == area):
            where = ", ".join(dict.fromkeys(edit.module.removeprefix("shift3d.") for edit in case.edits))
            rows.append(f"| {area}: {case.name} | {case.why} | {case.must} | {case.guard} | `{where}` |")
    return "\n".join(rows) + "\n"
