"""Replay of one mutant: `python tests/fuzz/replay.py KIND SEED [FOLDER]` makes it (in FOLDER), loads it, shows all."""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parents[1]))

from feeding import KINDS, limit_memory, make_mutant


def main(name: str, seed: str, folder: str | None = None) -> None:
    for path in sorted(Path(__file__).parent.glob("kinds_*.py")):
        importlib.import_module(path.stem)
    place = Path(folder or tempfile.mkdtemp(prefix="mutant-"))
    place.mkdir(parents=True, exist_ok=True)
    print(f"{make_mutant(KINDS[name], int(seed), place)}, in {place}")
    limit_memory()
    warnings.simplefilter("error", RuntimeWarning)
    print(f"valid: {str(KINDS[name].load(place))[:2000]}")


if __name__ == "__main__":
    main(*sys.argv[1:])
