"""Makes schema_N/: the output folder of a sweep stopped after two of its four tasks, by schema version N.

Each was made by the last program of its version, at the commit in COMMITS. To make a folder again, or that of a version
that has just become an older one:

    git worktree add /tmp/older COMMIT
    cp tests/reference/make_schema_folder.py /tmp/older/tests/reference/
    cd /tmp/older && PYTHONPATH=. python tests/reference/make_schema_folder.py

The task is the cheap one of tests/service, so the folder is small. A program that reads it must give the same final
tables as in a folder of its own.
"""

from __future__ import annotations

import platform
import shutil
import socket
import sys
from pathlib import Path

COMMITS = {5: "8a4453b", 6: "8effd78", 7: "29b8d99", 8: "ee35775", 9: "ce710c3", 10: "c538b44"}
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "service"))


def main() -> None:
    from cheap_task import KIND

    from shift3d.settings.compose import compose_sweep
    from shift3d.store.log import CommitLog
    from shift3d.store.schemas import SCHEMA_VERSION
    from shift3d.sweep.execution.worker import Worker
    from shift3d.sweep.planning.folder import open_folder
    from shift3d.sweep.planning.plan import make_plan

    if SCHEMA_VERSION not in COMMITS:
        raise SystemExit(f"this program writes schema version {SCHEMA_VERSION}, which is no older one")
    socket.gethostname = lambda: "machine"
    platform.platform = lambda *_: "Linux"
    folder = HERE / f"schema_{SCHEMA_VERSION}"
    shutil.rmtree(folder, ignore_errors=True)
    words = ["vehicle=suv", "scenes.count=2", "attack.lambda=1", "mode=shape,pose"]
    plan, _ = make_plan(compose_sweep("default", words), KIND.catalogue)
    open_folder(folder, plan)
    log = CommitLog(folder, plan.spec_hash)
    worker = Worker(KIND, plan.sweep, plan.assets)
    for index in range(2):
        outcome = worker.run_batch([plan.tasks[index]])
        log.commit(tuple(outcome.done), (), outcome.tables)


if __name__ == "__main__":
    main()
