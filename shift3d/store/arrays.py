"""Atomic writing and reading of NumPy archives and safetensors files."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write named arrays as .npz, atomically. Raises InputError: the disk is full or not writable."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, **arrays)

    write_atomic(path, write)


@contextmanager
def read_arrays(path: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """Yield the arrays of a file of `write_arrays` by name; each is read when it is requested.

    Raises: InputError naming the file if it cannot be read, is damaged, or lacks a requested array.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            yield arrays
    # RuntimeError: a damaged header says that the file is encrypted, or packed by another method.
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile) as error:
        what = f"is not the file that was written ({type(error).__name__})"
        raise InputError(what, str(path), "Remove the file: the same command makes it again") from error


def write_safetensors(path: Path, tensors: Mapping[str, Tensor | NDArray[Any]], metadata: Mapping[str, str]) -> None:
    """Write tensors or arrays, and text metadata, atomically. Equal content gives equal bytes.

    The metadata keys are sorted, since the library writes several keys in an order that differs between processes.

    Raises: InputError, see `write_atomic`.
    """
    import torch
    from safetensors.torch import save

    content = save({name: torch.as_tensor(values) for name, values in tensors.items()}, metadata=dict(metadata))
    data = 8 + int.from_bytes(content[:8], "little")
    header: dict[str, Any] = json.loads(content[8:data])
    ordered = {"__metadata__": dict(sorted(metadata.items()))} | {k: header[k] for k in header if k != "__metadata__"}
    text = json.dumps(ordered, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)  # the library pads the header in the same way
    write_atomic(path, len(text).to_bytes(8, "little") + text + content[data:])


def read_safetensors(
    path: Path | str | None, default: Path, framework: str
) -> tuple[dict[str, Any], dict[str, str], Path]:
    """Return the tensors, the metadata and the path of a file. path: None reads `default`, the shipped weights.

    framework: "pt" or "np". Raises InputError naming the file: the file is missing or unreadable.
    """
    from safetensors import SafetensorError, safe_open

    source = Path(path) if path is not None else default
    if not source.is_file():
        remedy = "Check the path" if path is not None else "Train it: shift3d train model=sdf"
        raise InputError("no such file", where=str(source), remedy=remedy)
    try:
        with safe_open(str(source), framework=framework) as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}, source  # noqa: SIM118
    except (SafetensorError, OSError, TypeError) as error:  # TypeError: NumPy lacks the dtype
        what = f"not a readable safetensors file ({error})"
        raise InputError(what, where=str(source), remedy="Copy it again") from error
