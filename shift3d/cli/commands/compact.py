"""\
Merges the commit log of a sweep into one entry and its segments into one file per table, so that commands read them
faster. Results and final tables do not change, and the sweep still resumes. The command stops a running driver within
seconds; the sweep's command resumes the sweep. A kill at any moment leaves a readable folder: run the command again.

examples:
  shift3d compact outputs/default-1a2b3c4d5e6f7a8b --dry-run
  shift3d compact outputs/default-1a2b3c4d5e6f7a8b
  shift3d compact s3://bucket/runs/kitti"""

from __future__ import annotations

import argparse

from shift3d.cli.command import Command
from shift3d.cli.commands.gc import OUT, dry_run, sweep_and_follow_up_folders
from shift3d.wording import counted


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.store.housekeeping import compact
    from shift3d.store.log_entries import read_log

    for folder in sweep_and_follow_up_folders(arguments.out):
        if arguments.dry_run:
            entries = read_log(folder)
            segments = [name for entry in entries for name in entry.segments]
            to = f"1 entry and {counted(len(set(segments)), 'segment')}"
            print(f"{folder}: {_files(len(entries), len(segments))} would become {to}")
            continue
        done = compact(folder)
        print(
            f"{folder}: {_files(done.entries, done.segments)} became 1 entry and "
            f"{counted(len(done.entry.segments), 'segment')}; {counted(done.removed, 'file')} removed"
        )
    return 0


def _files(entries: int, segments: int) -> str:
    return f"{counted(entries, 'log entry', 'log entries')} and {counted(segments, 'segment')}"


COMMAND = Command(
    "compact",
    "merge the many files of a sweep into a few",
    __doc__,
    _run,
    OUT,
    options=dry_run("merged", "merge"),
)
