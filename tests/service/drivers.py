"""Runs real drivers, most of them as processes, and reads their output folders."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

DRIVER = Path(__file__).resolve().parent / "driver.py"
DETERMINISTIC = ("scores", "solutions", "curves", "auc", "bev")
QUICK = ("scenes.count=4", "attack.lambda=1,10", "tracking=none")


class Drivers:
    """Sweep commands in a folder of their own. Processes still running at the end of a test are killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen[str]] = []

    def start(self, out: str, *words: str, prefix: tuple[str, ...] = (), **environment: str) -> subprocess.Popen[str]:
        return self._start([*prefix, sys.executable, str(DRIVER), *self._words(out, *words)], environment)

    def _words(self, out: str, *words: str) -> list[str]:
        return ["sweep", "default", *QUICK, *words, f"out={self.folder / out}"]

    def _start(self, command: list[str], environment: dict[str, str]) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command,
            cwd=self.folder,
            env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.started.append(process)
        return process

    def run(
        self, out: str, *words: str, prefix: tuple[str, ...] = (), alone: bool = False, **environment: str
    ) -> tuple[int, str, str]:
        """Run a command that ends by itself. Returns (exit code, stdout, stderr).

        The default is this process. A separate process (`alone`, or a prefix) takes seconds, and is for limits, or for
        changes at its start.
        """
        if not prefix and not alone:
            return self.run_here(self._words(out, *words), **environment)
        process = self.start(out, *words, prefix=prefix, **environment)
        output, errors = process.communicate(timeout=90)
        return process.returncode, output, errors

    def run_here(self, words: list[str], **environment: str) -> tuple[int, str, str]:
        """Run any command in this process. Returns (exit code, stdout, stderr)."""
        import driver

        output, errors = io.StringIO(), io.StringIO()
        # Ray's workers import the task by name.
        environment |= {"PYTHONPATH": os.pathsep.join([str(DRIVER.parent), os.environ.get("PYTHONPATH", "")])}
        with pytest.MonkeyPatch.context() as patch, contextlib.chdir(self.folder):
            for name, value in environment.items():
                patch.setenv(name, value)
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
                code = driver.main(words)
        return code, output.getvalue(), errors.getvalue()

    def final(self, out: str) -> dict[str, bytes]:
        return {name: (self.folder / out / "final" / f"{name}.parquet").read_bytes() for name in DETERMINISTIC}

    def committed(self, out: str) -> list[str]:
        """Return the task ids of the log in order, repetitions included."""
        entries = sorted((self.folder / out / "_log").glob("[0-9]*.json"))
        return [task for entry in entries for task in json.loads(entry.read_text())["done"].split()]

    def segments(self, out: str) -> set[str]:
        """Return the segment files that the log names."""
        entries = [json.loads(entry.read_text()) for entry in (self.folder / out / "_log").glob("[0-9]*.json")]
        return {name for entry in entries for name in entry["segments"].values()}

    def wait_for_commits(self, out: str, tasks: int) -> None:
        deadline = time.monotonic() + 240
        while len(self.committed(out)) < tasks:
            assert time.monotonic() < deadline, "the sweep commits nothing"
            time.sleep(0.02)

    def kill_all(self) -> None:
        for process in self.started:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
