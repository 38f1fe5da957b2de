"""Arrays in files that are there whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.store.atomic import write_atomic

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays by name as .npz, in one step. Raises InputError: the disk is full or not writable."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, **arrays)

    write_atomic(path, write)


def write_safetensors(path: Path, tensors: Mapping[str, Tensor | NDArray[Any]], metadata: Mapping[str, str]) -> None:
    """Write tensors or arrays, and texts, replacing the file in one step: equal content is equal bytes.

    The library writes metadata of several keys in an order that differs from process to process.

    Raises: InputError, see `write_atomic`.
    """
    import torch
    from safetensors.torch import save

    content = save({name: torch.as_tensor(values) for name, values in tensors.items()}, metadata=dict(metadata))
    data = 8 + int.from_bytes(content[:8], "little")
    header: dict[str, Any] = json.loads(content[8:data])
    ordered = {"__metadata__": dict(sorted(metadata.items()))} | {k: header[k] for k in header if k != "__metadata__"}
    text = json.dumps(ordered, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)  # as the library pads it
    write_atomic(path, len(text).to_bytes(8, "little") + text + content[data:])
