"""Composition of a sweep file and overrides by Hydra, once per sweep, with the axes of the sweep."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from shift3d.errors import InputError, empty_error
from shift3d.settings import messages
from shift3d.settings.folders import files, places, searched_folders_text, shipped, shown
from shift3d.settings.names import quoted, text_setting_paths
from shift3d.settings.schema.config import Config

Values = dict[str, Any]
_SMALL = "small"
_MERGED = ("effects",)
"""Config groups that allow several options together."""


@dataclass(frozen=True)
class Axis:
    """One axis of a sweep.

    key: a setting (``attack.lambda``) or a config group (``vehicle``). texts: values as Hydra writes them. values: of a
    setting, its values; of a group, all settings of each option. is_group: True if `key` is a config group.
    """

    key: str
    texts: tuple[str, ...]
    values: tuple[Any, ...]
    is_group: bool


@dataclass(frozen=True)
class ComposedSweep:
    """Composed sweep before the expansion of its axes. base: settings with each axis at its first value."""

    name: str
    overrides: tuple[str, ...]
    base: Values
    axes: tuple[Axis, ...]


def compose_sweep(
    name: str, overrides: Sequence[str] = (), own: bool = True, where: str | None = None
) -> ComposedSweep:
    """Compose a sweep file with overrides, once for all tasks.

    An override with several values (``vehicle=coupe,suv``) is an axis and replaces the sweep file's axis of the same
    key; axes keep Hydra's multirun order. ``size=small`` inserts the overrides that the sweep file lists under
    ``small``; the given overrides follow and win. own: a sweep file in the current folder wins over the shipped file;
    False: use the shipped file, as for commands whose sweep the user did not name. where: place that errors name; None:
    the sweep.

    Raises: InputError: unknown sweep, group, option or setting; unreadable or empty override; continuous or shuffled
    axis; no small size.
    """
    where = where or f"sweep {name}"
    sweeps = files("sweeps") if own else {name: shipped("sweeps") / f"{name}.yaml"}
    if name not in sweeps:
        raise messages.choice_error("sweep", name, sweeps, "sweeps/", searched_folders_text("sweeps"))
    for key, equals, value in (override.partition("=") for override in overrides):
        if equals and not value.strip():
            raise empty_error(key, where)  # a text setting would accept the empty value
    compose, parse = _hydra(sweeps[name], where)
    stated, params = compose([])
    axes_stated = [f"{key}={value}" for key, value in params.items()]
    listed, requested = (
        [quoted(word, text_setting_paths(Config)) for word in words] for words in (axes_stated, overrides)
    )
    small = _small(stated.get(_SMALL), parse(requested), where)
    words = [*listed, *small, *requested]
    axis_texts, fixed = _split(parse(words), where)
    first = [f"{key}={texts[0]}" for key, texts in axis_texts.items()]
    base, _ = compose([*fixed, *first])
    base.pop(_SMALL, None)
    _refuse_interpolations(base, where)
    axes = []
    for written, texts in axis_texts.items():
        key = written.lstrip("+")
        is_group = any(folder.is_dir() for folder in places(f"conf/{key}"))
        if is_group:
            rest = [text for text in first if not text.startswith(f"{key}=")]
            others = (compose([*fixed, *rest, f"{key}={text}"])[0][key] for text in texts[1:])
            values = (base[key], *others)
        else:
            values = tuple(parse([f"{key}={text}"])[0].value() for text in texts)
        _refuse_interpolations(list(values), where, key)
        axes.append(Axis(key, tuple(texts), values, is_group))
    return ComposedSweep(name, tuple(overrides), base, tuple(axes))


def _small(listed: Any, requested: Sequence[Any], where: str) -> list[str]:
    """Return the overrides of a sweep's small size; [] without ``size=small``."""
    sizes = [override for override in requested if override.get_key_element() == "size"]
    if any(override.is_sweep_override() for override in sizes):
        raise InputError("size cannot be an axis", where=where, remedy="Give it one value")
    if not sizes or sizes[-1].get_value_element_as_str() != _SMALL:
        return []
    if not isinstance(listed, dict) or not listed:
        remedy = "Cut it by hand, as with scenes.count=4"
        raise InputError("it has no small size", where=where, remedy=remedy)
    # A text is written as in an override, where 1,10 is two values; JSON of other values is valid YAML and Hydra.
    texts = text_setting_paths(Config)
    return [
        quoted(f"{key}={value}", texts) if isinstance(value, str) else f"{key}={json.dumps(value)}"
        for key, value in listed.items()
    ]


def _hydra(sweep: Path, where: str) -> tuple[Any, Any]:
    """Return two functions: overrides to (plain settings, axes of the file), and texts to parsed overrides."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    search = f"hydra.searchpath=[{','.join(_search_path())}]"

    def run(overrides: Sequence[str]) -> tuple[Values, Values]:
        # Exception: Hydra raises errors of its own and passes on YAML errors, ValueErrors and TypeErrors.
        try:
            return _composed(sweep, search, overrides)
        except Exception as error:
            known = chosen = None
            with contextlib.suppress(Exception):  # an unreadable file also fails without overrides
                known = chosen = _composed(sweep, search, [])[0]
                named = [text for text in overrides if "." not in text.partition("=")[0]]
                chosen = _composed(sweep, search, named)[0]
            raise messages.from_hydra(error, where, known, chosen, _Groups().get_group_options) from error

    def parse(texts: Sequence[str]) -> Any:
        parser = OverridesParser.create(config_loader=_Groups())  # type: ignore[arg-type]
        parsed = []
        for text in texts:  # one at a time, so that the error names the override
            try:
                parsed += parser.parse_overrides([text])
            except Exception as error:
                remedy = "Write key=value, and quote values with spaces or brackets: 'key=\"a b\"'"
                raise InputError(f"cannot read the override {text!r}", where, remedy) from error
        return parsed

    return run, parse


def _composed(sweep: Path, search: str, overrides: Sequence[str]) -> tuple[Any, Any]:
    """Return the plain settings and the axes of a sweep file under overrides. Raises: whatever Hydra raises."""
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    with initialize_config_dir(config_dir=str(sweep.parent.absolute()), version_base=None):
        config = compose(sweep.stem, overrides=[search, *overrides], return_hydra_config=True)
    own = [str(key) for key in config if key != "hydra"]
    axes = config.hydra.sweeper.params
    values = OmegaConf.to_container(OmegaConf.masked_copy(config, own))
    return values, OmegaConf.to_container(axes) if axes else {}


def _search_path() -> list[str]:
    """Return Hydra's search path for groups and for sweeps that a sweep includes, quoted for Hydra's grammar.

    Raises: InputError: the current folder has another program's conf/config.yaml, which would replace shift3d's.
    """
    folders = [folder.absolute() for folder in [*places("conf"), *places("sweeps")] if folder.is_dir()]
    own, theirs = folders[0] / "config.yaml", shipped("conf") / "config.yaml"
    if own.is_file() and own.read_bytes() != theirs.read_bytes():
        remedy = "Keep the groups that you add or change in conf/, without config.yaml; or run in another folder"
        raise InputError("it would take the place of shift3d's own", where=shown(own), remedy=remedy)
    return ["'file://" + str(folder).replace("'", "\\'") + "'" for folder in folders]


class _Groups:
    """Config loader for Hydra's ``glob()``: lists the options of a group, without shared files that begin with _."""

    def get_group_options(self, group_name: str, *_: object, **__: object) -> list[str]:
        return list(files(f"conf/{group_name}"))


def _split(parsed: Sequence[Any], where: str) -> tuple[dict[str, list[str]], list[str]]:
    """Split parsed overrides into (axis key to texts, fixed overrides). A later override of a key wins.

    The key of an axis keeps the + or ++ with which Hydra adds a setting.
    """
    axes: dict[str, list[str]] = {}
    fixed: dict[str, str] = {}
    for override in parsed:
        key = override.get_key_element()
        bare = key.lstrip("+")
        written = next((other for other in (*axes, *fixed) if other.lstrip("+") == bare), key)
        if override.is_delete():
            raise InputError(f"{override.input_line}: a setting cannot be removed", where, "Set it instead")
        if override.is_sweep_override():
            if not override.is_discrete_sweep():
                remedy = "List its values, or use range(start,stop,step)"
                raise InputError(f"{key} has a continuous axis ({override.input_line})", where, remedy)
            if getattr(override.value(), "shuffle", False):
                remedy = "List its values: another order at every call would be another sweep"
                raise InputError(f"{key} has a shuffled axis ({override.input_line})", where=where, remedy=remedy)
            fixed = {other: line for other, line in fixed.items() if other.lstrip("+") != bare}
            axes[written] = list(override.sweep_string_iterator())
            continue
        _check_options(key, override, where)
        if written in axes:
            axes[written] = [override.get_value_element_as_str()]
        else:
            fixed[key] = override.input_line
    empty = [key for key, texts in axes.items() if not texts]
    if empty:
        raise InputError(f"the axis {empty[0]} has no value", where=where, remedy=f"Give at least one: {empty[0]}=...")
    return axes, list(fixed.values())


def _check_options(group: str, override: Any, where: str) -> None:
    """Check the options of a group: Hydra's errors for ``effects=null`` or ``effects=[3]`` name no cause or options."""
    from hydra.core.override_parser.types import QuotedString

    if not group:
        raise InputError(f"{override.input_line}: no setting is named", where=where, remedy="Write key=value")
    options, value = _Groups().get_group_options(group), override.value()
    if options and isinstance(value, list) and len(value) > 1 and group not in _MERGED:
        remedy = f"Write several as an axis: {group}={','.join(map(str, value))}"
        raise InputError(f"{override.input_line}: {group} takes one option, and the last would win", where, remedy)
    for name in value if isinstance(value, list) else [value]:
        if options and not isinstance(name, str | QuotedString):
            written = "null" if name is None else str(name)
            raise messages.choice_error(group, written, options, where, searched_folders_text(f"conf/{group}"))


def _refuse_interpolations(values: Any, where: str, path: str = "") -> None:
    if isinstance(values, dict):
        for key, value in values.items():
            _refuse_interpolations(value, where, f"{path}.{key}" if path else str(key))
    elif isinstance(values, list):
        for value in values:
            _refuse_interpolations(value, where, path)
    elif isinstance(values, str) and "${" in values:
        # An interpolation could depend on an axis, but Hydra composes once for all tasks.
        raise InputError(f"{path} holds an interpolation", where=where, remedy="Write the value itself")


def validate(values: Values, where: str, axes: Sequence[str] = ()) -> Config:
    """Check settings against the schema. Raises: InputError naming the wrong field and its valid values.

    axes: groups that are axes of the sweep, where the command cannot give a setting of one option.
    """
    if not isinstance(values, dict):
        raise InputError(f"the settings are a {type(values).__name__}", where=where, remedy="Write NAME: VALUE lines")
    if lacking := [name for name, field in Config.model_fields.items() if field.is_required() and name not in values]:
        remedy = "Begin its file with `defaults: [/config, _self_]`, or with a sweep that ships in the place of /config"
        raise InputError(f"it does not say {', '.join(lacking)}", where=where, remedy=remedy)
    if "frontier" in values:
        remedy = "Run it with: shift3d frontier"
        raise InputError("it measures what accuracy costs and has no tasks", where, remedy)
    if missing := next((path for path, value in leaves(values) if value == "???"), None):
        group = missing.split(".")[0]
        by_itself = f"Add {missing}=VALUE to a sweep of this option of {group} alone"
        remedy = by_itself if group in axes else f"Add {missing}=VALUE to the command"
        raise InputError(f"{missing} is required", where=where, remedy=remedy)
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise messages.from_validation(error, where, values) from error


def leaves(values: Values, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every setting with its path, such as ``attack.steps``. A list counts as one setting."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
