"""The size of the package is counted by the content of its lines."""

from __future__ import annotations

from scripts.size import lines_of

TEXT = '''"""Module
of two lines."""

import os
from sys import (
    path,
)

# A comment.
def area(side: float) -> float:
    """Area."""
    return side * side  # not a comment line
'''


def test_every_line_counts_once() -> None:
    assert dict(lines_of(TEXT)) == {"docstrings": 3, "blank": 2, "imports": 4, "comments": 1, "code": 2}
