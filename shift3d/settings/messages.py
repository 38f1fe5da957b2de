"""One-line error messages for wrong settings."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from shift3d.errors import InputError
from shift3d.settings.folders import files, searched_folders_text, shipped, shown
from shift3d.settings.renamed import renamed_error

# Groups with a discriminated union, whose tag pydantic inserts into field paths.
_UNIONS = ("scenes", "vehicle", "naturalness", "runner", "tracking")


def choice_error(what: str, value: str, allowed: Iterable[str], where: str, looked: str = "") -> InputError:
    """Return the error for an unknown name: ``Did you mean 'suv'? One of: coupe, suv`` (a hint only if one is close).

    looked: searched folders, from :func:`~.folders.searched_folders_text`.
    """
    names = list(allowed)
    close = difflib.get_close_matches(value, names, n=1, cutoff=0.5)
    known = f"Did you mean {close[0]!r}? " if close else ""
    known += f"One of: {', '.join(names)}"
    return InputError(f"unknown {what} {value!r}", where=where, remedy=f"{known}. {looked}" if looked else known)


def from_validation(error: ValidationError, where: str, values: Mapping[str, Any] | None = None) -> InputError:
    """Convert the first failure of a pydantic validation to an error with field, valid values and remedy.

    values: the validated settings, for the names of the fields beside an unknown field.
    """
    first = error.errors(include_url=False)[0]
    # A discriminated union inserts its tag into the path: 'scenes.street.count' is the user's 'scenes.count'.
    path = [str(part) for part in first["loc"]]
    field = ".".join(part for i, part in enumerate(path) if not (i == 1 and path[0] in _UNIONS))
    # A union of plain types appends the type: 'accuracy.render.solver.bool'.
    field = re.sub(r"\.(bool|int|float|str|none|constrained-\w+|(list|tuple|dict)\[.*)$", "", field)
    value, kind = first["input"], first["type"]
    if value == "???" or kind == "missing":
        return InputError(f"{field} is required", where=where, remedy=f"Add {field}=VALUE to the command")
    if kind == "extra_forbidden":
        beside = sorted(_siblings(field, values or {}).keys() - {field})
        close = difflib.get_close_matches(field, beside, n=1)
        known = f"Did you mean {close[0]!r}? " if close else ""
        known += f"One of: {', '.join(beside)}" if beside else f"See {shown(shipped('conf'))} for all of them"
        return InputError(f"there is no setting {field}", where=where, remedy=known)
    if kind == "literal_error":
        allowed = re.findall(r"'([^']+)'|(\d+)", first["ctx"]["expected"])
        return choice_error(field, str(value), [text or number for text, number in allowed], where)
    if kind == "union_tag_invalid":
        tags_text = re.findall(r"'([^']+)'", first["ctx"]["expected_tags"])
        return choice_error(f"{field}.kind", str(first["ctx"]["tag"]), tags_text, where)
    if kind == "model_type":
        return InputError(f"{field} cannot be set as a whole", where, f"Set {field}.NAME=VALUE")
    if kind == "value_error":  # a rule between fields: its message names them, and may have a remedy
        error_text, *remedies = first["ctx"]["error"].args
        message = error_text if field in ("", where) else f"{field}: {error_text}"
        return InputError(message, where, *remedies or ["Change one of them"])
    what = f"{field} is {_shown(value)}: {first['msg'][0].lower()}{first['msg'][1:]}"
    remedy = first.get("ctx", {}).get("remedy", f"Change it with {field}=VALUE")
    return InputError(what, where=where, remedy=remedy)


def _shown(value: object) -> str:
    """Format a value, cut at 120 characters."""
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:120]}..."


def from_hydra(
    error: Exception,
    where: str,
    config: Mapping[str, Any] | None,
    chosen: Mapping[str, Any] | None,
    options: Callable[[str], Sequence[str]],
) -> InputError:
    """Convert an error of Hydra to an InputError with the valid names and the nearest of them.

    config: settings without overrides, for field names. chosen: settings with the group options that the overrides
    choose. options: function from a group's name to its options.
    """
    text = str(error)
    # Hydra's message is "Could not find" for a single option and "Could not load" for an option in a list.
    if match := re.search(r"Could not (?:find|load) '([^']+)'", text):
        group, _, name = match.group(1).rpartition("/")
        if (renamed := renamed_error(group, name)) is not None:
            return renamed
        if not options(group):
            remedy = (
                "Name a sweep alone, as in `- default`, an option with its group, as in `- override /attack: short`"
            )
            return InputError(f"there is no group {group!r} with {name!r}", where, remedy)
        return choice_error(group or "sweep", name, options(group), where, searched_folders_text(f"conf/{group}"))
    if match := re.search(r"Could not override '([^']+)'", text):
        key, beside = match.group(1), _siblings(match.group(1), config or {})
        if (renamed := renamed_error(key)) is not None:
            return renamed
        if isinstance(beside.get(key), Mapping):
            return InputError(f"{key} cannot be set as a whole", where=where, remedy=f"Set {key}.NAME=VALUE")
        names, having = sorted(_siblings(key, chosen or {})), _options_having(key)
        if having or key in beside:
            what = f"{key} is a setting of another option of {key.partition('.')[0]} than the chosen one"
            remedy = f"Choose one that has it: {', '.join(having)}" if having else "Leave it out"
            return InputError(what, where, f"{remedy}. The chosen one has: {', '.join(names)}")
        return choice_error("setting", key, names, where)
    remedy = f"See {shown(shipped('conf'))} for all settings"
    return InputError(" ".join(text.split())[:300], where=where, remedy=remedy)


def _siblings(key: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings beside an unknown one, path to value, in its innermost existing parent."""
    prefix = ""
    for part in key.split(".")[:-1]:
        if not isinstance(config.get(part), Mapping):
            break
        config, prefix = config[part], f"{prefix}{part}."
    return {f"{prefix}{name}": value for name, value in config.items()}


def _options_having(key: str) -> list[str]:
    """List the options of a setting's group whose files have the setting, such as scenes=kitti for scenes.root."""
    group, _, name = key.partition(".")
    own = re.compile(rf"^{re.escape(name)}:", re.MULTILINE)
    found = files(f"conf/{group}") if (shipped("conf") / group).is_dir() else {}
    return [f"{group}={option}" for option, file in found.items() if own.search(file.read_text(encoding="utf-8"))]
