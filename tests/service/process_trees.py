"""Processes below a process, from /proc."""

from __future__ import annotations

import time
from pathlib import Path


def descendants(pid: int, text: str, timeout_s: float = 30.0) -> list[int]:
    """Wait for at least one process below ``pid`` whose command line contains ``text``. Returns their ids."""
    deadline = time.monotonic() + timeout_s
    while not (found := [child for child in _below(pid) if text in _command(child)]):
        assert time.monotonic() < deadline, f"no process {text!r} below {pid}"
        time.sleep(0.05)
    return found


def _below(pid: int) -> list[int]:
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and (parent := _parent(entry)) is not None:
            parents[int(entry.name)] = parent
    found, new = [], [pid]
    while new:
        new = [child for child, parent in parents.items() if parent in new]
        found += new
    return found


def _parent(entry: Path) -> int | None:
    try:
        return int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return None


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""
