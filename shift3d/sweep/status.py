"""Status of a sweep, for another shell or machine.

The driver writes ``status.json`` beside the log every few seconds: the calls in flight and the speed. The file is
informative only: finished tasks are counted from the log.

Source: our choice.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.log import CommitLog, TakenOverError
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.sweep.planning.spec_file import read_spec
from shift3d.wording import counted, duration

if TYPE_CHECKING:
    from shift3d.sweep.execution.worker import Running

_FILE = "status.json"
_EVERY_S = 3.0
# A driver writes more often than this, even during a long commit.
_SILENT_S = 60.0
# Clocks that are synchronized agree better than this.
_CLOCKS_DIFFER_S = 5.0
_SHOWN = 8

State = Literal["starting", "running", "finished", "interrupted", "stopped"]


class StatusWriter:
    """Writer of the status file of a driver. log: of this driver. tasks: number of tasks that it runs."""

    def __init__(self, log: CommitLog, tasks: int) -> None:
        self._log = log
        self._tasks = tasks
        self._began = time.monotonic()
        self._written = float("-inf")
        self._finished = 0
        self._peak_mb = 0.0
        self._entries = len(log.entries)
        self._committed_unix_s: float | None = None
        self._left_out: Sequence[str] = ()

    def left_out(self, lines: Sequence[str]) -> None:
        """Set the lines on machines that can run no task."""
        self._left_out = lines

    def finished(self, tasks: int, peak_mb: float) -> None:
        """Count tasks that are done or quarantined. peak_mb: memory of the worker that ran them."""
        self._finished += tasks
        self._peak_mb = max(self._peak_mb, peak_mb)

    def write(self, running: Sequence[Running], workers: int, state: State = "running") -> None:
        """Write the file, unless it was just written. A failure is ignored: the log counts without a status.

        Raises: TakenOverError: another driver runs the sweep, and writes the file.
        """
        if len(self._log.entries) != self._entries:
            self._entries, self._committed_unix_s = len(self._log.entries), time.time()
        now = time.monotonic()
        if state == "running" and now - self._written < _EVERY_S:
            return
        if state == "running":
            self._written = now
        values = {
            "driver": self._log.driver,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "pid_began": _began(os.getpid()),
            "state": state,
            "written_unix_s": time.time(),
            "left": self._tasks - self._finished,
            "workers": workers,
            "per_s": self._finished / max(now - self._began, 1e-3),
            "worker_peak_mb": self._peak_mb,
            "committed_unix_s": self._committed_unix_s,
            "running": [{"what": r.label, "seconds": r.seconds, "worker": r.worker} for r in running[:_SHOWN]],
            "running_calls": len(running),
            "left_out": list(self._left_out[:_SHOWN]),
        }
        try:
            self._log.check_there()
            if state == "running":
                self._log.check_own()
            (self._log.folder / _FILE).write_atomic(json.dumps(values, indent=1).encode() + b"\n")
        except TakenOverError:
            raise
        except (InputError, OSError, ValueError):
            return


@dataclass(frozen=True)
class SweepStatus:
    """Progress of a sweep by its log, and the last status of its driver (`progress`; None if there is no readable one).

    commits: since the compaction of the log, if there was one. driver: of the last log entry; None if that is a
    compaction, whose process has ended.
    """

    sweep: str
    planned: int
    done: int
    quarantined: int
    commits: int
    compacted: bool
    driver: str | None
    progress: dict[str, Any] | None

    @property
    def left(self) -> int:
        """Number of tasks that are neither done nor quarantined."""
        return self.planned - self.done - self.quarantined


def read_status(folder: LocationLike) -> SweepStatus:
    """Return the status of the sweep in ``folder``.

    Raises: InputError: the folder is not a sweep's, or its log is damaged.
    """
    folder = as_location(folder)
    spec = read_spec(folder)
    entries = read_log(folder)
    done = {task for entry in entries for task in entry.done}
    quarantined = {task for entry in entries for task in entry.quarantined} - done
    commits = sum(entry.kind == "commit" for entry in entries)
    compacted = any(entry.kind == "compact" for entry in entries)
    driver = entries[-1].driver if entries and entries[-1].kind != "compact" else None
    return SweepStatus(
        spec["sweep"],
        int(spec["tasks"]),
        len(done),
        len(quarantined),
        commits,
        compacted,
        driver,
        _by_this_clock(folder, _read_progress(folder)),
    )


def _by_this_clock(folder: Location, progress: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return a driver's status with times by this machine's clock.

    A remote driver that seems silent, or to write in the future, may have a clock that is hours off. The function waits
    some seconds to see if the driver writes again.
    """
    if progress is None or progress["state"] not in ("starting", "running") or _is_here(progress):
        return progress
    if -_CLOCKS_DIFFER_S <= time.time() - progress["written_unix_s"] <= _SILENT_S:
        return progress
    time.sleep(2 * _EVERY_S)
    again = _read_progress(folder)
    if again is None or again["written_unix_s"] == progress["written_unix_s"]:
        return again
    off = time.time() - again["written_unix_s"]
    committed = again.get("committed_unix_s")
    return {**again, "written_unix_s": time.time(), "committed_unix_s": committed and committed + off}


def _is_here(progress: dict[str, Any]) -> bool:
    return bool(progress["host"] == socket.gethostname() and Path("/proc/self").exists())


def _read_progress(folder: Location) -> dict[str, Any] | None:
    try:
        progress = json.loads((folder / _FILE).read_bytes())
        numbers = [progress[name] for name in ("written_unix_s", "per_s", "workers", "pid", "running_calls")]
        numbers.append(progress.get("left", 0))  # a driver of an older program does not say it
        texts = [progress[name] for name in ("driver", "host", "state")]
        calls = [(str(call["what"]), float(call["seconds"])) for call in progress["running"]]
        left_out = [str(line) for line in progress.get("left_out", ())]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    sound = all(isinstance(n, int | float) for n in numbers) and all(isinstance(text, str) for text in texts)
    return {**progress, "running": calls, "left_out": left_out} if sound else None


def status_lines(status: SweepStatus) -> str:
    """Return the text that ``shift3d sweep status`` prints."""
    share = (status.done + status.quarantined) / max(status.planned, 1)
    lines = [
        f"{status.sweep}: {status.done} of {counted(status.planned, 'task')} done ({share:.0%}), "
        f"{status.quarantined} quarantined, {status.left} left, {_commits(status)}"
    ]
    progress = status.progress
    if progress is None:
        return "\n".join([*lines, "no driver has written a status into this folder"])
    alive = _alive(status, progress)
    lines.append(f"driver {progress['driver']} on {progress['host']}: {alive}")
    if committed := progress.get("committed_unix_s"):
        lines.append(f"last commit {duration(time.time() - committed)} ago")
    if alive == "running":
        rate = progress["per_s"]
        # The log counts a quarantined task that is retried as ended.
        eta = f", about {duration(progress.get('left', status.left) / rate)} left" if rate > 0 else ""
        lines.append(f"{rate:.3g} tasks a second on {counted(progress['workers'], 'worker')}{eta}")
        if progress.get("worker_peak_mb"):
            lines.append(f"a worker uses up to {progress['worker_peak_mb']:.0f} MB")
        since = time.time() - progress["written_unix_s"]
        lines += [f"  running: {what}, for {duration(seconds + since)}" for what, seconds in progress["running"]]
        if (more := progress["running_calls"] - len(progress["running"])) > 0:
            lines.append(f"  and {counted(more, 'call')} more")
    lines += progress["left_out"]
    return "\n".join(lines)


def _commits(status: SweepStatus) -> str:
    if not status.compacted:
        return counted(status.commits, "commit")
    return f"log compacted, {counted(status.commits, 'commit')} since" if status.commits else "log compacted"


def _alive(status: SweepStatus, progress: dict[str, Any]) -> str:
    """Return "running" or why not. A driver on this machine is looked up; a remote one is judged by its silence."""
    awake = progress["state"] in ("starting", "running")
    if not status.left and (not awake or status.driver != progress["driver"]):
        return "finished"
    if status.driver not in (None, progress["driver"]):
        return f"taken over by driver {status.driver}"
    if not awake:
        return str(progress["state"])
    here = _is_here(progress)
    # Another process may have the id after a reboot, or in a container that was restarted.
    began = _began(progress["pid"]) if here else None
    if here and (began is None or progress.get("pid_began", began) != began):
        return "dead; the command of the sweep resumes it"
    silent = time.time() - progress["written_unix_s"]
    if not here and silent > _SILENT_S:
        return f"silent for {duration(silent)}; if the driver is dead, the command of the sweep resumes it"
    return str(progress["state"])


def _began(pid: int) -> str | None:
    """Return the start of a local process in kernel ticks since boot; None without the process or /proc."""
    try:
        state = Path(f"/proc/{pid:d}/stat").read_text()
    except OSError:
        return None
    return state.rpartition(")")[2].split()[19]  # the name, in brackets, may contain anything
