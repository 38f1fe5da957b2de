"""Reader of a sweep's spec.yaml without the imports of a plan, since the status command waits for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml  # type: ignore[import-untyped]

from shift3d.errors import InputError
from shift3d.store.migrations import older_versions
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMA_VERSION

_KINDS: dict[str, tuple[type, ...]] = {
    **{"sweep": (str,), "spec_hash": (str, int), "tasks": (int,)},
    **{"overrides": (list,), "axes": (dict,), "settings": (dict,)},
}
"""Required keys and types: a truncated spec can be valid YAML. A hand-typed hash of digits alone is a number."""


def read_spec(folder: LocationLike) -> dict[str, Any]:
    """Read ``spec.yaml`` of a sweep.

    Raises: InputError: the file is absent, unreadable, truncated, or of a schema version that this program cannot read.
    """
    location = as_location(folder)
    path = location / "spec.yaml"
    try:
        values = yaml.safe_load(path.read_text())
        older_versions(values["schema_version"], str(path))
        if wrong := [name for name, kind in _KINDS.items() if not isinstance(values[name], kind)]:
            raise ValueError(f"{wrong[0]} is a {type(values[wrong[0]]).__name__}")
        return {**values, "schema_version": SCHEMA_VERSION}
    except FileNotFoundError as error:
        why = "it has no spec.yaml" if location.names() else "it does not exist, or is empty"
        what = f"is not the output folder of a sweep ({why})"
        raise InputError(what, where=str(folder), remedy="Check the path") from error
    except NotADirectoryError as error:
        what = "is a file, not the output folder of a sweep"
        raise InputError(what, where=str(folder), remedy="Check the path") from error
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, RecursionError) as error:
        raise InputError("is not the spec of a sweep", where=str(path), remedy="Restore it from a copy") from error


def refuse_follow_up(spec: Mapping[str, Any], folder: LocationLike) -> None:
    """Refuse a follow-up's folder, such as OUT/verification: its tasks have the ids of the sweep's, but no scores.

    spec: of `read_spec`. Raises: InputError.
    """
    assets = spec.get("assets")
    if isinstance(assets, list) and any(isinstance(part, dict) and part.get("results") for part in assets):
        what = f"holds a follow-up of sweep {spec['sweep']}, not the sweep"
        raise InputError(what, where=str(folder), remedy="Give the folder of the sweep, which holds this folder")
