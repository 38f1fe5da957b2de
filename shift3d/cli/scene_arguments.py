"""Words for labelled scenes of files, common to several commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from shift3d.cli.command import real_number, refuse
from shift3d.errors import InputError

if TYPE_CHECKING:
    from shift3d.settings.schema.scenes import KittiConfig, OpenPcdetConfig

FRAME_SETS = {"kitti": ("root",), "openpcdet": ("root", "split", "sensor_m", "ground_z_m", "reflectance_max")}
"""Value of scenes= and the keys of its frames, `root` first."""
FRAMES_HELP = "[root=PATH] [sensor_m=[x,y,z]] [ground_z_m=Z] [reflectance_max=R]"
_EXAMPLES = {"ground_z_m": "-1.8", "reflectance_max": "255"}


def refuse_other_keys(values: Mapping[str, str], kind: str, keys: Mapping[str, tuple[str, ...]], where: str) -> None:
    """Refuse the keys of other scenes than `kind`. keys: of each kind. Raises: InputError: the first such key."""
    all_keys = dict.fromkeys(key for of_one in keys.values() for key in of_one)
    refuse(values, [key for key in all_keys if key not in keys[kind]], f"means nothing for scenes={kind}", where)


def frames_config(values: Mapping[str, str], kind: str, count: int | None, where: str) -> KittiConfig | OpenPcdetConfig:
    """Return the settings of labelled frames. kind: of FRAME_SETS. count: number of frames; None: all.

    Raises: InputError: no root=, or an invalid value.
    """
    from pydantic import ValidationError

    from shift3d.settings import messages
    from shift3d.settings.schema.scenes import KittiConfig, OpenPcdetConfig

    if not values.get("root"):
        holds = "KITTI's training/" if kind == "kitti" else "points/ and labels/"
        raise InputError("root= is missing", where, f"Give root=PATH, the folder that holds {holds}")
    if kind == "kitti":
        return KittiConfig(kind="kitti", root=values["root"], count=count, names=None)
    numbers = {key: real_number(values, key, where, like) for key, like in _EXAMPLES.items()}
    frames = {"kind": kind, "root": values["root"], "count": count, "names": None, "split": values.get("split")}
    try:
        sensor_m = _position(values.get("sensor_m", "[0,0,0]"), where)
        return OpenPcdetConfig.model_validate({**frames, "sensor_m": sensor_m, **numbers})
    except ValidationError as error:
        raise messages.from_validation(error, where) from error


def _position(text: str, where: str) -> list[float]:
    try:
        return [float(part) for part in text.strip("[]").split(",")]
    except ValueError as error:
        raise InputError(f"sensor_m={text!r} is no position", where, "Give sensor_m=[0,0,1.8]") from error
