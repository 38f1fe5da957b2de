"""Measures what README and docs quote, and draws their tables from it.

``python docs/scripts/evidence [--plan | --draw] [--again] [ONLY=NAME,NAME] [kitti=PATH] [real=PATH]``

Each measurement of plan.yaml that is not current runs in outputs/evidence/NAME-DIGEST, writes docs/measured/NAME.json
and is skipped from then on, until a file that it depends on changes. The same command resumes. --plan says what would
run; --draw only draws the tables; --again measures what is current, too. kitti: a folder that holds training/; real: a
folder that holds vehicles/ and more_vehicles/ (meshes). What lacks its words is left out and named.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.evidence import pages, record
from scripts.evidence.plan import Entry, read_plan, table
from scripts.evidence.readers import read_figures


def main(arguments: list[str]) -> int:
    """0: all that was asked for is measured; 1: something failed; 2: wrong words."""
    given = dict(word.split("=", 1) for word in arguments if "=" in word)
    flags, only = {word for word in arguments if "=" not in word}, given.pop("ONLY", None)
    every = read_plan()
    entries = [entry for entry in every if only is None or entry.name in only.split(",")]
    known = {word for entry in every for word in entry.needs}
    if flags - {"--plan", "--draw", "--again"} or given.keys() - known or not entries:
        names = ", ".join(entry.name for entry in every)
        print(f"{__doc__}\nmeasurements: {names}", file=sys.stderr)
        return 2
    if "--plan" in flags:
        print(table(entries))
        return 0
    failed = []
    for entry in [] if "--draw" in flags else entries:
        if entry.state() == "current" and "--again" not in flags:
            print(f"{entry.name}: current")
        elif lacking := [word for word in entry.needs if word not in given]:
            print(f"{entry.name}: left out, give {' '.join(f'{word}=PATH' for word in lacking)}")
        elif problem := measure(entry, given):
            print(f"{entry.name}: {problem}", file=sys.stderr)
            failed.append(entry.name)
    for page in pages.draw():
        print(f"{page.relative_to(record.ROOT)} drawn")
    return 1 if failed else 0


def measure(entry: Entry, given: Mapping[str, str]) -> str | None:
    """Run an entry and write its file. What went wrong, or None."""
    if dirty := record.uncommitted(entry.depends):
        return f"commit first what it depends on: {', '.join(dirty[:5])}"
    commit, digest = record.git("rev-parse", "HEAD").strip(), record.digest(entry.depends)
    out = record.ROOT / "outputs" / "evidence" / f"{entry.name}-{digest[:12]}"
    out.mkdir(parents=True, exist_ok=True)
    print(f"{entry.name}: expected to take {entry.minutes:g} minutes", flush=True)
    output = ""
    for line in entry.run:
        words = [word.format(out=out, **given) for word in shlex.split(line)]
        code, text = _run(words, entry.env, out)
        if code:
            return f"`{line}` ended with exit code {code}; the same command resumes"
        output += text
    figures = read_figures(out, output, entry.read)
    stamp = {
        "commit": commit,
        "files": list(entry.depends),
        "digest": digest,
        "machine": record.machine(),
        "command": entry.command,
        "seconds": round(sum(map(float, (out / "seconds").read_text().split()))),
    }
    print(f"{record.write(entry.name, figures, stamp).relative_to(record.ROOT)}: {len(figures)} figures")
    return None


def _run(words: list[str], env: Mapping[str, str], out: Path) -> tuple[int, str]:
    """Exit code and output of a command, which is shown as it comes. Its seconds are added to the folder's."""
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
