"""\
list prints the names of the scenes that the settings select. show describes one of them (scene=NAME, else the first),
counts the places for a car and the reasons against other places, and draws the scene from above and at an angle, with
its labels and these places, into out=FILE.png.

The words are those of a sweep, so that settings that work here work there: scenes=waymo|argoverse2|nuscenes|openpcdet|
kitti|street, scenes.root=PATH, the other settings of the data set, and attack.placement.* (docs/guides/scenes.md).

examples:
  shift3d scenes list scenes=waymo scenes.root=PATH scenes.every=10
  shift3d scenes list scenes=nuscenes scenes.root=s3://BUCKET/nuscenes scenes.version=v1.0-mini
  shift3d scenes show scenes=argoverse2 scenes.root=PATH out=outputs/scene.png
  shift3d scenes show scenes=openpcdet scenes.root=PATH scene=000008 scenes.sensor_m=[0,0,1.8]"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from shift3d.cli.command import Command, pop_values
from shift3d.cli.completion import overrides
from shift3d.errors import InputError
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.settings.schema.config import Config

_ACTIONS = ("list", "show")
_WORDS = ("scene=", "scenes=", "scenes.", "attack.placement.")
_SWEEP = "retrieval"  # of the scene settings this sweep sets the group alone: conf/scenes gives the other defaults


def scenes_words(prefix: str, parsed_args: argparse.Namespace | None = None, **_: Any) -> list[str]:
    """Complete a word after ``shift3d scenes``: list, show, then settings of scenes."""
    if not list(getattr(parsed_args, "words", None) or []) and "=" not in prefix:
        return [word for word in _ACTIONS if word.startswith(prefix)]
    known = overrides(prefix)
    return [word for word in known if word.startswith((*_WORDS, "out="))]


def _run(arguments: argparse.Namespace) -> int:
    action, *words = arguments.words or [""]
    if action not in _ACTIONS:
        what = f"cannot read {action!r}" if action else "no action is given"
        raise InputError(what, "scenes", f"Give one of: {', '.join(_ACTIONS)}")
    out, settings = pop_values("out", words)
    config = _config(settings)
    if action == "list":
        if out:
            raise InputError("out= means nothing for list", "scenes", "Leave it out, or use show")
        return _list(config)
    return _show(config, out[-1] if out else None)


def _config(words: Sequence[str]) -> Config:
    """Compose the settings for these words. Raises: InputError: a foreign word, or several values of a setting."""
    from shift3d.settings.compose import compose_sweep, validate

    foreign = [word for word in words if not word.startswith(_WORDS)]
    if foreign:
        one_of = "One of: scenes=, scenes.SETTING=, scene=, out=, attack.placement.SETTING="
        raise InputError(f"cannot read {foreign[0]!r}", "scenes", one_of)
    composed = compose_sweep(_SWEEP, ["scenes=street", *words], own=False, where="scenes")
    for axis in composed.axes:
        if axis.key.startswith("scene") or axis.key.startswith("attack.placement"):
            raise InputError(
                f"{axis.key} has several values", "scenes", "Give it one value; lists are in brackets: [a,b]"
            )
    return validate(composed.base, "scenes")


def _list(config: Config) -> int:
    from shift3d.settings.schema.scenes import scene_set

    scenes = scene_set(config.scenes)
    names = scenes.names()
    for name in names:
        print(name)
    print(f"{counted(len(names), 'scene')} of {scenes.dataset}")
    return 0


def _show(config: Config, out: str | None) -> int:
    from pathlib import Path

    from shift3d.scenes.description import describe_scene
    from shift3d.settings.schema.scenes import scene_set
    from shift3d.store.atomic import check_writable
    from shift3d.task.places import NO_GROUND, survey_scene
    from shift3d.task.spec import PlacementSpec

    path = None if out is None else Path(out).expanduser()
    if path is not None:
        if path.suffix != ".png":
            raise InputError(f"out={out} is no name of a PNG", "scenes", "Give out=FILE.png")
        check_writable(path.parent, "out=FILE.png")
    scenes = scene_set(config.scenes)
    name = config.scene or scenes.names()[0]
    scene = scenes.load(name)
    print("\n".join(describe_scene(scene)))
    centre, half_width = scenes.placement_sector_rad
    settings = config.attack.placement.model_dump()
    where = PlacementSpec(**settings, sector_centre_rad=centre, sector_half_width_rad=half_width)
    places = survey_scene(scenes, name, where)
    print(f"{'places for a car:':<22}{places.line()}")
    if places.lacks_ground:
        print(f"{'':<22}{NO_GROUND}")
    if scene.conditions.weather != "dry" and not scene.conditions.weather_in_points:
        print(f"{'weather:':<22}a sweep simulates it; places and picture are those of clear weather")
    if path is not None:
        from shift3d.scenes.picture import save_picture

        path.parent.mkdir(parents=True, exist_ok=True)
        save_picture(scene, path, free_m=places.xy_m[places.free])
        print(f"{path} written")
    return 0


COMMAND = Command(
    "scenes",
    "list the scenes of a data set, or show one",
    __doc__,
    _run,
    words="list or show, then scenes=NAME scenes.root=PATH [scene=NAME] [out=FILE.png]",
    metavar="WORD",
    complete=scenes_words,
)
