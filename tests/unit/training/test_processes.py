"""Processes that share work: one that the system ends is reported in a line."""

from __future__ import annotations

import os
import signal

import pytest

from shift3d.errors import InputError
from shift3d.training.processes import each


def _killed_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)  # as the system does when memory runs out
    return number


def test_a_killed_process_is_one_clear_line() -> None:
    with pytest.raises(InputError, match=r"one of 2 processes ended early.*fewer workers="):
        list(each(_killed_at_three, range(6), 2))
