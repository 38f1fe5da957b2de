"""A process can read another one's current task while that process hangs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from shift3d.sweep.execution.ray.worker_status import WorkerStatus, read_worker_status

# Prints the path of its status file, then hangs in the third task of its call, in the way that its argument names.
HANGS = """
import re, sys, threading, time
from shift3d.sweep.execution.ray.worker_status import WorkerStatusFile

def sleeps():
    time.sleep(3600)

def holds_the_interpreter():
    re.match("(a+)+$", "a" * 64 + "b")

def ends():
    status_file.note(None)
    time.sleep(3600)

threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()
status_file = WorkerStatusFile()
status_file.note(2)
print(status_file.path, flush=True)
globals()[sys.argv[1]]()
"""

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGUSR2"), reason="no such signals here")


@pytest.fixture
def hanging(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], tuple[str, subprocess.Popen[str]]]]:
    # From a file, so that its stack trace can show source lines.
    script = tmp_path_factory.mktemp("hangs") / "hangs.py"
    script.write_text(HANGS)
    started: list[subprocess.Popen[str]] = []

    def start(how: str) -> tuple[str, subprocess.Popen[str]]:
        process = subprocess.Popen([sys.executable, str(script), how], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        path = process.stdout.readline().strip()
        time.sleep(0.3)
        return path, process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("how", "line"), [("sleeps", "time.sleep(3600)"), ("holds_the_interpreter", 're.match("(a+)+$"')]
)
def test_the_stack_of_a_task_that_hangs_ends_where_it_is(
    hanging: Callable[[str], tuple[str, subprocess.Popen[str]]], how: str, line: str
) -> None:
    path, process = hanging(how)
    for _ in range(2):  # text of the first time is not repeated
        at = read_worker_status(path, process.pid)
        assert at.index == 2 and 0.2 < at.seconds < 60
        assert at.stack.count("globals()[sys.argv[1]]()") == 1 and line in at.stack, at.stack
        assert at.stack.index("globals()") < at.stack.index(line), "the innermost call comes last"
    assert process.poll() is None, "who is looked at goes on"


def test_a_stopped_process_says_which_task_and_no_stack(
    hanging: Callable[[str], tuple[str, subprocess.Popen[str]]],
) -> None:
    path, process = hanging("sleeps")
    process.send_signal(signal.SIGSTOP)
    at = read_worker_status(path, process.pid)
    assert at.index == 2 and at.stack == ""


def test_between_tasks_there_is_nothing_to_see(hanging: Callable[[str], tuple[str, subprocess.Popen[str]]]) -> None:
    path, process = hanging("ends")
    at = read_worker_status(path, process.pid)
    assert at == WorkerStatus(None, at.seconds, "")


def test_a_process_that_is_gone_is_no_other_ones_business(
    hanging: Callable[[str], tuple[str, subprocess.Popen[str]]],
) -> None:
    path, process = hanging("sleeps")
    process.kill()
    process.wait()
    with pytest.raises(OSError):
        read_worker_status(path, process.pid)
    # The process id may have another owner by now, without a handler, which the signal would end.
    with pytest.raises(OSError):
        read_worker_status(path, os.getpid())
