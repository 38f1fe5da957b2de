"""\
Removes the files that killed drivers left in a sweep's folder (or s3://, gs://): segments that the commit log does not
name, log entries that a compaction replaced, and temporary files. Safe while the sweep runs: the command never touches
files of the driver that may be running. It keeps and lists files that shift3d did not write.

examples:
  shift3d gc outputs/default-1a2b3c4d5e6f7a8b --dry-run    show what would be removed
  shift3d gc outputs/default-1a2b3c4d5e6f7a8b
  shift3d gc s3://bucket/runs/kitti"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from shift3d.cli.command import Command
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.store.location import Location

_SHOWN = 20
OUT = "output folder of a sweep, or its URL"


def dry_run(done: str, do: str) -> Callable[[argparse.ArgumentParser], object]:
    """Return a function that adds the option --dry-run. done, do: participle and infinitive of the command's verb."""
    return lambda parser: parser.add_argument(
        "--dry-run", action="store_true", help=f"show what would be {done}, and {do} nothing"
    )


def sweep_and_follow_up_folders(out: str) -> list[Location]:
    """Return a sweep's folder and those of its verification, patterns and retrievals. Raises: InputError: no sweep."""
    from shift3d.store.resolve import as_location
    from shift3d.sweep.planning.spec_file import read_spec
    from shift3d.sweep.retrieval import FOLDER as RETRIEVALS

    folder = as_location(out)
    read_spec(folder)
    inner = [place / name for place in (folder, folder / RETRIEVALS) for name in place.names()]
    return [folder, *(place for place in inner if (place / "spec.yaml").is_file())]


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.store.housekeeping import collect, find_garbage

    for folder in sweep_and_follow_up_folders(arguments.out):
        garbage = find_garbage(folder)
        action = "would be removed" if arguments.dry_run else "removed"
        print(
            f"{folder}: {counted(len(garbage.segments), 'segment')} that no log entry names, "
            f"{counted(len(garbage.replaced), 'log entry', 'log entries')} that a compaction replaced, "
            f"{counted(len(garbage.temporary), 'temporary file')} {action}"
        )
        for file in garbage.files[:_SHOWN]:
            print(f"  {file}")
        if len(garbage.files) > _SHOWN:
            print(f"  and {len(garbage.files) - _SHOWN} more")
        for name in garbage.unknown[:_SHOWN]:
            print(f"  kept, not written by shift3d: {folder / 'data' / name}")
        if not arguments.dry_run:
            collect(garbage)
    return 0


COMMAND = Command(
    "gc",
    "remove the files that killed drivers left",
    __doc__,
    _run,
    OUT,
    options=dry_run("removed", "remove"),
)
