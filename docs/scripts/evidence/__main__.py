"""Measures the figures that README and docs quote, and draws their tables.

``python docs/scripts/evidence [--plan | --draw] [--again] [ONLY=NAME,NAME] [kitti=PATH] [real=PATH]``
``python docs/scripts/evidence ONLY=NAME folder=PATH commit=HASH``

Each measurement of plan.yaml that is not current runs in outputs/evidence/NAME-DIGEST, writes docs/measured/NAME.json
and is skipped until a file that it depends on changes. The same command resumes. --plan lists the measurements that
would run; --draw only draws the tables; --again repeats current measurements. kitti: a folder that holds training/;
real: a folder that holds vehicles/ and more_vehicles/ (meshes). A measurement that lacks its words is left out and
named. folder: results of one measurement, run by hand on this machine at a commit; the script only reads them.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.evidence import pages, record
from scripts.evidence.plan import Entry, read_plan, table
from scripts.evidence.readers import read_figures


def main(arguments: list[str]) -> int:
    """Return 0 if everything requested is measured, 1 if a measurement failed, 2 for wrong words."""
    given = dict(word.split("=", 1) for word in arguments if "=" in word)
    flags, only = {word for word in arguments if "=" not in word}, given.pop("ONLY", None)
    every = read_plan()
    entries = [entry for entry in every if only is None or entry.name in only.split(",")]
    by_hand = {"folder", "commit"} & given.keys()
    known = {"folder", "commit", *(word for entry in every for word in entry.needs)}
    wrong = flags - {"--plan", "--draw", "--again"} or given.keys() - known or len(by_hand) * len(entries) not in (0, 2)
    if wrong or not entries:
        names = ", ".join(entry.name for entry in every)
        print(f"{__doc__}\nmeasurements: {names}", file=sys.stderr)
        return 2
    if "--plan" in flags:
        print(table(entries))
        return 0
    problems = [] if "--draw" in flags else [_one(entry, given, "--again" in flags) for entry in entries]
    for page in pages.draw():
        print(f"{page.relative_to(record.ROOT)} drawn")
    return 1 if any(problems) else 0


def _one(entry: Entry, given: Mapping[str, str], again: bool) -> str | None:
    """Measure an entry if necessary and print its state. Returns an error text, or None."""
    if "folder" in given:
        problem = read_by_hand(entry, Path(given["folder"]), given["commit"])
    elif not again and entry.state() == "current":
        print(f"{entry.name}: current")
        return None
    elif lacking := [word for word in entry.needs if word not in given]:
        print(f"{entry.name}: left out, give {' '.join(f'{word}=PATH' for word in lacking)}")
        return None
    else:
        problem = measure(entry, given, again)
    if problem:
        print(f"{entry.name}: {problem}", file=sys.stderr)
    return problem


def measure(entry: Entry, given: Mapping[str, str], again: bool = False) -> str | None:
    """Run an entry and write its file. Returns an error text, or None."""
    if dirty := record.uncommitted(entry.depends):
        return f"commit first what it depends on: {', '.join(dirty[:5])}"
    commit, digest = record.git("rev-parse", "HEAD").strip(), record.digest(entry.depends)
    out = record.ROOT / "outputs" / "evidence" / f"{entry.name}-{digest[:12]}"
    if again:
        shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    print(f"{entry.name}: expected to take {entry.minutes:g} minutes", flush=True)
    return _run_and_write(entry, entry.run, given, out, commit)


def read_by_hand(entry: Entry, folder: Path, commit: str) -> str | None:
    """Read results of an entry's commands from a folder at a commit; run only the entry's scripts that read results."""
    reading = [line for line in entry.run if line.startswith("python docs/scripts/sweep_figures.py ")]
    return _run_and_write(entry, reading, {}, folder.resolve(), record.git("rev-parse", commit).strip())


def _run_and_write(entry: Entry, lines: Sequence[str], given: Mapping[str, str], out: Path, commit: str) -> str | None:
    output = ""
    for line in lines:
        words = [word.format(out=out, **given) for word in shlex.split(line)]
        code, text = _run(words, entry.env, out)
        if code:
            return f"`{line}` ended with exit code {code}; the same command resumes"
        output += text
    try:
        figures = read_figures(out, output, entry.read)
    except (ValueError, OSError) as error:
        return f"cannot be read: {error}"
    took = (out / "seconds").read_text().split() if lines == entry.run else []
    stamp = {
        "commit": commit,
        "files": list(entry.depends),
        "digest": record.digest(entry.depends, commit),
        "machine": record.machine(),
        "command": entry.command,
        "seconds": round(sum(map(float, took))) or None,
    }
    print(f"{record.write(entry.name, figures, stamp).relative_to(record.ROOT)}: {len(figures)} figures")
    return None


def _run(words: list[str], env: Mapping[str, str], out: Path) -> tuple[int, str]:
    """Run a command, show its output and add its seconds to the folder's. Returns exit code and output."""
    print(f"$ {shlex.join(words)}", flush=True)
    own = {"python": [sys.executable], "shift3d": [sys.executable, "-m", "shift3d.cli.main"]}
    words[:1] = own.get(words[0], words[:1])
    paths = os.pathsep.join([str(record.ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    start, kept = time.monotonic(), []
    try:
        with subprocess.Popen(
            words, cwd=record.ROOT, env={**os.environ, **env, "PYTHONPATH": paths}, stdout=subprocess.PIPE, text=True
        ) as process:
            for text in process.stdout or ():
                print(text, end="", flush=True)
                kept.append(text)
    finally:
        with (out / "seconds").open("a") as file:
            file.write(f"{time.monotonic() - start:.1f}\n")
    return process.returncode, "".join(kept)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
