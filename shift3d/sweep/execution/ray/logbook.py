"""What a worker is at, for others on its machine to read: without a word of its own, whatever it hangs in.

Ray would let a second thread of the worker answer. But then the thread that waits for questions asks for Python's lock
250 times a second, and two workers on two cores get 3 to 4 % less done.
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

# The task's place in its call (-1 between tasks), since when by the machine's monotonic clock, and the thread.
_ENTRY = struct.Struct("<qdQ")
_NAME = "shift3d-logbook"
_SIGNAL = signal.SIGUSR2
_STACK_S = 2.0
_FRAME = re.compile(r'^  File "(.*)", line (\d+) in (.*)$', re.MULTILINE)


@dataclass(frozen=True)
class Whereabouts:
    """What a worker is at: the task's place in its call (None between tasks), for how long, and its stack, the
    innermost call last ("" where the process is stopped)."""

    index: int | None
    seconds: float
    stack: str


class Logbook:
    """Kept by the process that it is about, and gone with it.

    Attributes:
        path: where other processes of this user find it, on this machine.
    """

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self._file = os.memfd_create(_NAME)
            self.path = f"/proc/{os.getpid()}/fd/{self._file}"
        else:
            self._file, self.path = tempfile.mkstemp(prefix=f"{_NAME}-")
        self.note(None)
        os.lseek(self._file, _ENTRY.size, os.SEEK_SET)
        # In C: it works while another thread holds the interpreter.
        faulthandler.register(_SIGNAL, file=self._file, all_threads=True)

    def note(self, index: int | None) -> None:
        """A task begins in this thread, or (None) the last one of a call has ended. Takes a microsecond."""
        entry = _ENTRY.pack(-1 if index is None else index, time.monotonic(), threading.get_ident())
        os.pwrite(self._file, entry, 0)


def read_logbook(path: str, pid: int) -> Whereabouts:
    """What another process of this machine is at.

    Raises: OSError: there is no such process any more.
    """
    # Held, so that no other process can get its number before the signal.
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
    return Whereabouts(index if index >= 0 else None, seconds, stack)


def _stack(file: int, pid: int, process: int | None, thread: int) -> str:
    """Ask for the stacks of all threads, wait for that of one."""
    before = max(os.fstat(file).st_size, _ENTRY.size)
    if process is not None:
        signal.pidfd_send_signal(process, _SIGNAL)
    else:
        os.kill(pid, _SIGNAL)
    until, size = time.monotonic() + _STACK_S, -1
    while time.monotonic() < until:
        time.sleep(0.05)
        # It is written in many pieces.
        size, last = os.fstat(file).st_size, size
        if before < size == last:
            break
    stacks = os.pread(file, max(size - before, 0), before).decode(errors="replace")
    of_thread = stacks.partition(f"0x{thread:016x} ")[2].partition("\n\n")[0]
    of_thread = re.split(r"\n(?:Current thread|Thread) ", of_thread)[0]
    frames = [traceback.FrameSummary(name, int(line), where) for name, line, where in _FRAME.findall(of_thread)]
    return "".join(traceback.StackSummary.from_list(frames[29::-1]).format())
