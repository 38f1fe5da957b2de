"""Mutation testing of a seeded sample: break the code in single places, count the breaks that a test notices.

    python tests/mutants.py shift3d/render --count 40 --seed 0

cosmic-ray makes the mutants in a copy of the tree and runs the tests that `TESTS` names for a package. A mutant counts
as noticed when an assertion fails or an `InputError` is raised or missing (`--assertions-only`, see conftest.py). A
test that merely crashes proves nothing. The table lists the other mutants, with their difference.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "shift3d/render": "tests/hard_cases tests/unit/render tests/gradients",
    "shift3d/attack": "tests/hard_cases tests/unit/attack",
    "shift3d/detectors": "tests/hard_cases tests/unit/detectors",
    "shift3d/geometry": "tests/hard_cases tests/unit/geometry",
    "shift3d/store": "tests/hard_cases tests/unit/store",
}
"""Packages and the tests that should notice a break in them."""
TIMEOUT_S = 240.0
# Only a type checker reads these operators: they have no effect at run time.
NO_BEHAVIOUR = ("core/ReplaceBinaryOperator_BitOr",)


def main() -> None:
    """Make, sample and run mutants; print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", choices=TESTS, nargs="?", default="shift3d/render")
    parser.add_argument("--count", type=int, default=40, help="mutants in the sample (default: 40)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default: 0)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = _copy(Path(folder))
        session = tree / "mutants.sqlite"
        (tree / "mutants.toml").write_text(_config(given.room))
        _cosmic_ray(tree, "init", "mutants.toml", session.name)
        with use_db(session) as db:
            chosen = _sample(db, given.count, given.seed)
            run = subprocess.Popen([*_COMMAND, "exec", "mutants.toml", session.name], cwd=tree, env=_environment(tree))
            _watch(run, db, len(chosen))
            print(_table(db, chosen))


_COMMAND = (str(Path(sys.executable).parent / "cosmic-ray"),)


def _cosmic_ray(tree: Path, *words: str) -> None:
    subprocess.run([*_COMMAND, *words], cwd=tree, check=True, env=_environment(tree))


def _environment(tree: Path) -> dict[str, str]:
    """Return an environment with the copy's package, not the installed one, and without another mutant's bytecode."""
    return {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "SHIFT3D_REAL_DATA": "absent"}


def _copy(folder: Path) -> Path:
    """Copy the tracked files of the tree in their current state."""
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\n")
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)
    return folder


def _config(room: str) -> str:
    command = f"{sys.executable} -m pytest -n 0 -x -q -p no:cacheprovider --assertions-only {TESTS[room]}"
    return (
        f'[cosmic-ray]\nmodule-path = "{room}"\ntimeout = {TIMEOUT_S}\nexcluded-modules = []\n'
        f'test-command = "{command}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )


def _sample(db: WorkDB, count: int, seed: int) -> set[str]:
    """Sample all mutants and skip the others. The sample is the same for a seed as long as the package is unchanged."""
    items = list(db.work_items)
    behaviour = [item for item in items if not item.mutations[0].operator_name.startswith(NO_BEHAVIOUR)]
    behaviour.sort(key=lambda item: str(item.mutations[0]))
    chosen = {item.job_id for item in random.Random(seed).sample(behaviour, min(count, len(behaviour)))}
    for item in items:
        if item.job_id not in chosen:
            db.set_result(item.job_id, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))
    return chosen


def _watch(run: subprocess.Popen[bytes], db: WorkDB, count: int) -> None:
    with tqdm(total=count, unit="mutant") as bar:
        total = db.num_work_items
        while run.poll() is None:
            try:
                run.wait(2.0)
            except subprocess.TimeoutExpired:
                bar.update(count - (total - db.num_results) - bar.n)
    if run.returncode:
        raise SystemExit(f"cosmic-ray ended with {run.returncode}")


def _table(db: WorkDB, chosen: set[str]) -> str:
    where = {item.job_id: item.mutations[0] for item in db.work_items}
    results = [(where[job], result) for job, result in db.results if job in chosen]
    missed = [(m, r) for m, r in results if r.test_outcome == TestOutcome.SURVIVED]
    lines = [f"{len(results)} mutants, {len(results) - len(missed)} noticed, {len(missed)} by no assertion"]
    for mutation, result in missed:
        changed = [x for x in str(result.diff).splitlines() if x[:1] in "+-" and x[:3] not in ("+++", "---")]
        lines += [f"\n{mutation.module_path}:{mutation.start_pos[0]} {mutation.operator_name}", *changed]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
