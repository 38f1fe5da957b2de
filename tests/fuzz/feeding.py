"""Mutants of input files fed to the public loaders, each kind in a child process, and their outcomes.

A kind of input states how a valid input is written, how a mutant of it is made from a seed, and what loading it must
give. Outcomes are "error" (an InputError that names the file, in one line, with a remedy), "valid" (the invariants
hold), and failures: any other exception, a violated invariant, more than SECONDS of processor time, a process that
dies, more memory than MEMORY_BYTES, or a warning of the arithmetic (overflow, invalid value).

The child process is necessary: no signal handler can interrupt native code that hangs, and native code that crashes
would end the tests.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shift3d.errors import InputError

SECONDS = 5.0
WALL_SECONDS = 60.0
"""For one mutant: other work may slow this process down, but hardly this much."""
MEMORY_BYTES = 2**31
"""Address space beyond that of the process: libraries reserve some, an absurd length asks for more."""
GROWTH_BYTES = 400 * 2**20
"""Memory in use beyond that of the process."""


@dataclass(frozen=True)
class InputKind:
    """One kind of input.

    name: of the kind. count: number of mutants. write: writes a valid input into an empty folder. mutate: changes the
    input and returns a word for the change. load: loads it through the public loader, checks the invariants of the
    result and returns its identity (compared if `mutate` says "harmless"). named: words of which an error must contain
    one; None: the name of a file in the folder.
    """

    name: str
    count: int
    write: Callable[[Path], None]
    mutate: Callable[[Path, np.random.Generator], str]
    load: Callable[[Path], Any]
    named: tuple[str, ...] | None = None


@dataclass
class Report:
    """Outcomes by seed."""

    kind: str
    outcomes: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0

    def counts(self) -> Counter[str]:
        """Count each outcome: "error", "valid", "failed"."""
        return Counter(o if o in ("error", "valid") else "failed" for o in self.outcomes.values())

    def failures(self) -> list[str]:
        """Return one line per failed seed, with the command that replays it."""
        failed = [(seed, text) for seed, text in self.outcomes.items() if text not in ("error", "valid")]
        return [f"{text}   (python tests/fuzz/replay.py {self.kind!r} {seed})" for seed, text in failed]


KINDS: dict[str, InputKind] = {}
REPORTS: dict[str, Report] = {}


def register(kind: InputKind) -> None:
    """Add a kind of input to the list."""
    assert kind.name not in KINDS
    KINDS[kind.name] = kind


def generator(kind: str, seed: int) -> np.random.Generator:
    """Return the only source of a mutant's randomness."""
    return np.random.default_rng([zlib.crc32(kind.encode()), seed])


def feed(kind: InputKind, seeds: Sequence[int] | None = None) -> Report:
    """Load every mutant of a kind. If the child dies or hangs, only its current mutant is lost."""
    report, began = Report(kind.name), time.monotonic()
    left = list(range(kind.count) if seeds is None else seeds)
    with tempfile.TemporaryDirectory() as place:
        original = Path(place) / "original"
        original.mkdir()
        kind.write(original)
        expected = kind.load(original)
        while left:
            done = _in_child(kind, left, Path(place), expected)
            report.outcomes |= done
            left = [seed for seed in left if seed not in done]
    report.seconds = time.monotonic() - began
    REPORTS[kind.name] = report
    return report


def _in_child(kind: InputKind, seeds: list[int], place: Path, expected: Any) -> dict[int, str]:
    """Return outcomes until the child has finished, or one mutant has ended the child."""
    reader, writer = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _child(kind, seeds, place, expected, writer)
    os.close(writer)
    done: dict[int, str] = {}
    running, buffer = seeds[0], b""
    with os.fdopen(reader, "rb", buffering=0) as pipe:
        ended = None
        while ended is None:
            ended = _wait(pipe.fileno(), child)
            if ended is None and not (chunk := pipe.read(65536)):
                break
            buffer += chunk if ended is None else b""
            *lines, buffer = buffer.split(b"\n")
            for line in lines:
                seed, text = json.loads(line)
                if text == "begins":
                    running = seed
                else:
                    done[seed] = text
    _, status = os.waitpid(child, 0)
    if running not in done:
        done[running] = ended or f"the process died (status {status})"
    return done


def _wait(pipe: int, child: int) -> str | None:
    """Wait for the child's next message. Returns its failure if the wait took too long."""
    began, used = time.monotonic(), _processor_seconds(child)
    while not select.select([pipe], [], [], 0.2)[0]:
        if (
            _processor_seconds(child) - used > SECONDS + 1.0 or time.monotonic() - began > WALL_SECONDS
        ):  # the child itself counts to SECONDS if possible
            os.kill(child, signal.SIGKILL)
            return f"took over {SECONDS:.0f} s"
    return None


def _processor_seconds(process: int) -> float:
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _child(kind: InputKind, seeds: list[int], place: Path, expected: Any, writer: int) -> None:
    """Load mutants and report. Never returns: whatever happens, only the parent continues the tests."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        limit_memory()
        for seed in seeds:
            os.write(writer, json.dumps([seed, "begins"]).encode() + b"\n")
            try:
                outcome = outcome_of(kind, seed, place, expected)
            except BaseException:
                outcome = f"the mutant could not be made: {traceback.format_exc()[-600:]}"
            os.write(writer, json.dumps([seed, outcome]).encode() + b"\n")
    finally:
        os._exit(0)


def limit_memory() -> None:
    """Limit the address space to MEMORY_BYTES more than in use, for good."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def make_mutant(kind: InputKind, seed: int, folder: Path) -> str:
    """Write a mutant into an empty folder. Returns how it was made."""
    kind.write(folder)
    return kind.mutate(folder, generator(kind.name, seed))


def outcome_of(kind: InputKind, seed: int, place: Path, expected: Any) -> str:
    """Return "error", "valid", or a description of the failure."""
    with tempfile.TemporaryDirectory(dir=place) as name:
        folder = Path(name)
        how = make_mutant(kind, seed, folder)
        memory, began = _peak_memory(), time.process_time()
        outcome = _loaded(kind, folder, how, expected)
        if time.process_time() - began > SECONDS:
            return f"{how}: took over {SECONDS:.0f} s"
        if _peak_memory() - memory > GROWTH_BYTES:
            return f"{how}: took {(_peak_memory() - memory) / 2**20:.0f} MB"
        return outcome


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _loaded(kind: InputKind, folder: Path, how: str, expected: Any) -> str:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            result = kind.load(folder)
    except InputError as error:
        wrong = _unclear(error, kind, folder)
        if how == "harmless":
            return f"harmless, and refused: {error}"
        return f"{how}: {wrong}: {str(error)[:300]!r}" if wrong else "error"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{how}: {type(error).__name__}: {str(error)[:200]} ({Path(where.filename).name}:{where.lineno})"
    if how == "harmless" and result != expected:
        return f"harmless, and gives {str(result)[:100]}, not {str(expected)[:100]}"
    return "valid"


def _unclear(error: InputError, kind: InputKind, folder: Path) -> str:
    """Return the defect of an error message, such as a missing remedy."""
    text = str(error)
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "allocates what a header asks for"
        cause = cause.__cause__ or cause.__context__
    names = kind.named or tuple(path.name for path in folder.rglob("*") if path.is_file())
    if not any(name in text for name in names):
        return "names no file"
    if not text.isprintable():
        return "is not one printable line"
    if len(text) > 1000:
        return f"has {len(text)} letters"
    return "" if error.remedy else "has no remedy"
