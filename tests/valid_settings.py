"""A small handmade installation: a sweep file that holds every setting itself, and two config groups.

Hydra takes a third of a second to compose the repository's own files, and much less for these.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from shift3d.settings import folders
from shift3d.settings.compose import ComposedSweep, compose_sweep

HEAD = {"defaults": [{"/vehicle": "coupe"}, {"/attack": "paper"}, "_self_"]}
AXES = {"hydra": {"sweeper": {"params": {"attack.lambda": "1,10"}}}}


@functools.cache
def _composed() -> ComposedSweep:
    return compose_sweep("smoke", ["vehicle=suv", "mode=shape"])


def settings() -> dict[str, Any]:
    """Return a task's complete settings."""
    return json.loads(json.dumps(_composed().base))  # type: ignore[no-any-return]


def write_installation(folder: Path) -> None:
    values = settings()
    vehicle, attack = values.pop("vehicle"), values.pop("attack")
    for place, content in (
        ("sweeps/mine.yaml", HEAD | values | AXES),
        ("conf/vehicle/coupe.yaml", {**vehicle, "name": "coupe"}),
        ("conf/vehicle/suv.yaml", vehicle),
        ("conf/attack/paper.yaml", attack),
    ):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(yaml.safe_dump(content, sort_keys=False))
    (folder / "words").write_text("")


@contextlib.contextmanager
def installed(folder: Path) -> Iterator[None]:
    """Use the folder as the installation of shift3d."""
    before = folders.__file__
    folders.__file__ = str(folder / "shift3d" / "settings" / "folders.py")
    try:
        with contextlib.chdir(folder):  # no other sweeps/ or conf/ precede
            yield
    finally:
        folders.__file__ = before
