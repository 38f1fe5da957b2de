"""Plan of measurements (plan.yaml), and the state of each measurement in docs/measured."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from scripts.evidence import record

PLAN = Path(__file__).with_name("plan.yaml")


@dataclass(frozen=True)
class Entry:
    """Measurement. run: commands, with {out} for its folder and other words in braces for values of the caller.

    depends: file globs. minutes: expected on two cores. read: see readers. env: environment variables of the commands.
    """

    name: str
    run: Sequence[str]
    depends: Sequence[str]
    minutes: float
    read: Sequence[Mapping[str, Any]]
    env: Mapping[str, str] = field(default_factory=dict)

    @property
    def needs(self) -> list[str]:
        """Words that the caller must give."""
        return sorted({word for line in self.run for word in re.findall(r"{(\w+)}", line)} - {"out"})

    @property
    def command(self) -> str:
        """The commands as recorded: without a path of this machine."""
        lines = [re.sub(r"{(\w+)}", lambda match: match[1].upper(), line) for line in self.run]
        return " ".join([*(f"{key}={value}" for key, value in self.env.items()), "; ".join(lines)])

    def state(self) -> str:
        """Return the state of the figures: missing, current, or the reason why they are stale."""
        if not (record.MEASURED / f"{self.name}.json").exists():
            return "missing"
        measured = record.read(self.name)["measured"]
        if not measured["commit"]:
            return "stale: the commit measured is not recorded"
        try:
            if record.uncommitted(self.depends):
                return "stale: files it depends on are not committed"
            same = measured["digest"] == record.digest(self.depends)
        except record.NoGitError:
            return "unknown: no git"
        return "current" if same else f"stale: measured at {measured['commit'][:7]}"


def read_plan() -> list[Entry]:
    """Read all entries, in the order in which they run."""
    found = yaml.safe_load(PLAN.read_text(encoding="utf-8"))
    return [_entry(name, words, found["rooms"]) for name, words in found["entries"].items()]


def _entry(name: str, given: Mapping[str, Any], rooms: Mapping[str, Sequence[str]]) -> Entry:
    words = {"depends": [], **given}
    if sweep := words.pop("sweep", None):
        made = f"shift3d sweep {sweep} runner.workers=2 tracking=none out={{out}}/sweep"
        figures = "python docs/scripts/sweep_figures.py {out}/sweep json={out}/figures.json"
        words["run"] = [made, *words.pop("then", []), figures]
        words["depends"] = ["sweep", f"sweeps/{sweep.split()[0]}.yaml", *words["depends"]]
        words.setdefault("read", [{"json": "figures.json"}])
    return Entry(name, **{**words, "depends": list(dict.fromkeys(_globs(words["depends"], rooms)))})


def _globs(names: Sequence[str], rooms: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for name in names:
        if name in rooms:
            yield from _globs(rooms[name], rooms)
        else:
            yield name


def table(entries: Sequence[Entry]) -> str:
    """Format all measurements with their duration and state."""
    rows = [(e.name, f"{e.minutes:g}", ", ".join(f"{word}=" for word in e.needs), e.state()) for e in entries]
    lines = [f"{'measurement':24s} {'minutes':>7s}  {'needs':14s} state"]
    lines += [f"{name:24s} {minutes:>7s}  {needs:14s} {state}" for name, minutes, needs, state in rows]
    left = sum(entry.minutes for entry, row in zip(entries, rows) if row[3] != "current")
    return "\n".join([*lines, f"{left:.0f} minutes of two cores are left ({left / 60:.1f} hours)"])
