"""Worker status file: lets the driver read which task a worker runs, even while that worker hangs.

Ray would let a second thread of the worker answer. But that thread, while it waits for queries, takes Python's lock 250
times a second, and two workers on two cores get 3 to 4 % less done.
"""

from __future__ import annotations

import faulthandler
import os
import re
import signal
import struct
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass

# Index of the task in its call (-1 between tasks), its start by the machine's monotonic clock, and the thread id.
_ENTRY = struct.Struct("<qdQ")
_NAME = "shift3d-worker-status"
_SIGNAL = signal.SIGUSR2
_STACK_S = 2.0
_FRAME = re.compile(r'^  File "(.*)", line (\d+) in (.*)$', re.MULTILINE)


@dataclass(frozen=True)
class WorkerStatus:
    """Status of a worker. index: of the task in its call, None between tasks. seconds: since then. stack: innermost
    call last; "" between tasks, or if a stopped process does not write it."""

    index: int | None
    seconds: float
    stack: str


class WorkerStatusFile:
    """Status file of this process. On Linux (memfd) the file disappears with the process; on other systems it
    stays in the folder of temporary files, since Ray ends workers without their finalizers.

    Attributes:
        path: name for other processes of this user on this machine.
    """

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self._file = os.memfd_create(_NAME)
            self.path = f"/proc/{os.getpid()}/fd/{self._file}"
        else:
            self._file, self.path = tempfile.mkstemp(prefix=f"{_NAME}-")
        self.note(None)
        os.lseek(self._file, _ENTRY.size, os.SEEK_SET)
        # faulthandler is in C: it works while another thread holds the interpreter.
        faulthandler.register(_SIGNAL, file=self._file, all_threads=True)

    def note(self, index: int | None) -> None:
        """Record that a task begins in this thread, or (None) that a call's last one has ended. Takes a microsecond."""
        entry = _ENTRY.pack(-1 if index is None else index, time.monotonic(), threading.get_ident())
        os.pwrite(self._file, entry, 0)


def read_worker_status(path: str, pid: int) -> WorkerStatus:
    """Read the status of another process on this machine. Raises OSError: the process has ended."""
    # An open pidfd keeps the kernel from reusing the process id before the signal is sent.
    process = os.pidfd_open(pid) if hasattr(os, "pidfd_open") else None
    try:
        file = os.open(path, os.O_RDONLY)
        try:
            index, since, thread = _ENTRY.unpack(os.pread(file, _ENTRY.size, 0))
            seconds = time.monotonic() - since
            stack = _stack(file, pid, process, thread) if index >= 0 else ""
        finally:
            os.close(file)
    finally:
        if process is not None:
            os.close(process)
    return WorkerStatus(index if index >= 0 else None, seconds, stack)


def _stack(file: int, pid: int, process: int | None, thread: int) -> str:
    """Request the stacks of all threads of a process, and wait for that of one."""
    before = max(os.fstat(file).st_size, _ENTRY.size)
    if process is not None:
        signal.pidfd_send_signal(process, _SIGNAL)
    else:
        os.kill(pid, _SIGNAL)
    until, size = time.monotonic() + _STACK_S, -1
    while time.monotonic() < until:
        time.sleep(0.05)
        # The process writes in many pieces: wait until the size is stable.
        size, last = os.fstat(file).st_size, size
        if before < size == last:
            break
    stacks = os.pread(file, max(size - before, 0), before).decode(errors="replace")
    of_thread = stacks.partition(f"0x{thread:016x} ")[2].partition("\n\n")[0]
    of_thread = re.split(r"\n(?:Current thread|Thread) ", of_thread)[0]
    frames = [traceback.FrameSummary(name, int(line), where) for name, line, where in _FRAME.findall(of_thread)]
    return "".join(traceback.StackSummary.from_list(frames[29::-1]).format())
