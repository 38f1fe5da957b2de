"""Training checkpoints: files written atomically, and read as tensors and plain values only."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write nested dicts, lists, numbers, strings and tensors to `path`. Raises: InputError, see `write_atomic`."""
    content = io.BytesIO()
    torch.save(state, content)
    write_atomic(path, content.getvalue())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read the checkpoint at `path`.

    Raises: InputError naming the file if it is missing, or cannot be read as tensors and plain values.
    """
    if not path.is_file():
        raise InputError("no such checkpoint", where=str(path), remedy="Train first")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged pickle can raise any exception type
        raise InputError("not a readable checkpoint", where=str(path), remedy="Delete it to start over") from error
    if not isinstance(state, dict):
        raise InputError("not a checkpoint of a training", where=str(path), remedy="Delete it to start over")
    return state
