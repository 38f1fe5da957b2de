"""Equal content gives an equal file in every process, and the library can read the file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save

from shift3d.store.arrays import write_safetensors

TENSORS = {"b": torch.arange(3.0), "a": torch.ones(2, 5, dtype=torch.float16), "c": np.arange(4, dtype=np.int64)}
TEXTS = {name: f"text of {name}, with an umlaut: ä" for name in ("steps", "recipe", "baselines", "family", "seed")}


def test_what_was_written_is_read(tmp_path: Path) -> None:
    write_safetensors(tmp_path / "some" / "file.safetensors", TENSORS, TEXTS)
    with safe_open(tmp_path / "some" / "file.safetensors", framework="pt") as file:
        assert file.metadata() == TEXTS and set(file.keys()) == set(TENSORS)
        for name, values in TENSORS.items():
            read = file.get_tensor(name)
            assert torch.equal(read, torch.as_tensor(values)) and read.dtype == torch.as_tensor(values).dtype


def test_one_text_is_the_file_that_the_library_writes(tmp_path: Path) -> None:
    tensors, texts = {"weight": torch.randn(7, 3)}, {"recipe": "steps=3"}
    write_safetensors(tmp_path / "file", tensors, texts)
    assert (tmp_path / "file").read_bytes() == save(tensors, metadata=texts)


def test_every_process_writes_the_same_bytes(tmp_path: Path) -> None:
    code = f"""
import torch
from pathlib import Path
from shift3d.store.arrays import write_safetensors
write_safetensors(Path({str(tmp_path)!r}) / "other", {{"b": torch.arange(3.0), "a": torch.ones(4)}}, {TEXTS!r})
"""
    seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONHASHSEED": seed})
    write_safetensors(tmp_path / "own", {"b": torch.arange(3.0), "a": torch.ones(4)}, TEXTS)
    assert (tmp_path / "own").read_bytes() == (tmp_path / "other").read_bytes()
