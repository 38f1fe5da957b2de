"""Processes that share work: one that the system ends is reported in a line; all end with the process they serve."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from shift3d.errors import InputError
from shift3d.processes import each


def _killed_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)  # as the system does when memory runs out
    return number


def test_a_killed_process_is_one_clear_line() -> None:
    with pytest.raises(InputError, match=r"one of 2 processes ended early.*fewer workers="):
        list(each(_killed_at_three, range(6), 2))


_POOL = """
import time
from shift3d.processes import process_pool
if __name__ == "__main__":
    with process_pool(2) as pool:
        print(*pool.map(abs, range(4)), flush=True)
        time.sleep(600)
"""


def test_processes_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "pool.py"
    script.write_text(_POOL)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "0 1 2 3\n"
        parent.kill()
        parent.communicate(timeout=60)  # the stream ends when the last process that holds it has ended
