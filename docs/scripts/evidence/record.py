"""Measured figures in docs/measured/NAME.json, and their records in docs/measured/records/NAME.json.

NAME.json maps each figure's name to value, unit, interval, commit, command and, where known, n. The record states once
for all of them commit, machine, command, seconds, the files that the figures depend on and their digest at that commit.
A commit of None is not known: ``written_at`` then names the commit that added the figures.
"""

from __future__ import annotations

import fnmatch
import functools
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
MEASURED = ROOT / "docs" / "measured"
_OF_RECORD = ("commit", "command")


class NoGitError(Exception):
    """The checkout has no git repository, or the repository lacks the requested object."""


def figure(
    value: float | str, unit: str = "", low: float | None = None, high: float | None = None, n: int | None = None
) -> dict[str, Any]:
    """Return a figure as stored in a file: without unknown fields, numbers rounded to six digits."""
    interval = None if low is None or high is None else [_short(low), _short(high)]
    full = {"value": _short(value), "unit": unit, "interval": interval, "n": n}
    return {key: one for key, one in full.items() if one not in (None, "")}


def _short(value: float | str) -> float | str:
    return value if isinstance(value, str | int) else float(f"{float(value):.6g}")


def read(name: str) -> dict[str, Any]:
    """Read an entry: its record as ``measured``, and its ``figures``."""
    rows: dict[str, dict[str, Any]] = json.loads(_file(name).read_text(encoding="utf-8"))
    figures = {
        key: {part: one for part, one in row.items() if part not in _OF_RECORD and one not in (None, "")}
        for key, row in rows.items()
    }
    return {"measured": json.loads(_record_file(name).read_text(encoding="utf-8")), "figures": figures}


def write(name: str, figures: Mapping[str, Any], measured: Mapping[str, Any]) -> Path:
    """Write an entry's figures, one per line, and then its record. Each file is written whole or not at all."""
    from shift3d.store.atomic import write_atomic

    known = {part: measured.get(part) for part in _OF_RECORD}
    rows = {key: {"value": None, "unit": "", "interval": None} | one | known for key, one in figures.items()}
    body = ",\n".join(f" {json.dumps(key)}: {json.dumps(row, ensure_ascii=False)}" for key, row in rows.items())
    _record_file(name).parent.mkdir(exist_ok=True)
    write_atomic(_file(name), f"{{\n{body}\n}}\n".encode())
    write_atomic(_record_file(name), (json.dumps(measured, indent=1, ensure_ascii=False) + "\n").encode())
    return _file(name)


def _file(name: str) -> Path:
    return MEASURED / f"{name}.json"


def _record_file(name: str) -> Path:
    return MEASURED / "records" / f"{name}.json"


def git(*words: str) -> str:
    """Return the output of a git command. Raises NoGitError if the command fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise NoGitError(f"git {' '.join(words)}: {getattr(error, 'stderr', error)}") from error
    return done.stdout


@functools.cache
def _blobs(commit: str) -> dict[str, str]:
    rows = (row.split("\t") for row in git("ls-tree", "-r", "-z", commit).split("\0") if row)
    return {path: head.split()[2] for head, path in rows}


def matching(paths: Iterable[str], globs: Sequence[str]) -> list[str]:
    """Return the sorted paths that match a glob; ``*`` matches slashes, too."""
    return sorted(path for path in paths if any(fnmatch.fnmatchcase(path, glob) for glob in globs))


def digest(globs: Sequence[str], commit: str = "HEAD") -> str:
    """Compute the digest of the contents of all matching files at a commit."""
    blobs = _blobs(commit)
    text = "\n".join(f"{path} {blobs[path]}" for path in matching(blobs, globs))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def uncommitted(globs: Sequence[str]) -> list[str]:
    """Return the matching files that differ from HEAD."""
    rows = [row[3:] for row in git("status", "--porcelain", "-z", "--no-renames").split("\0") if row]
    return matching(rows, globs)


def machine() -> str:
    """Return the processor's name and its number of cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"
