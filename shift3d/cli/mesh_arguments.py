"""Words for the orientation and scale of a vehicle in a mesh file: forward= up= unit= length_m=."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.cli.command import real_number

if TYPE_CHECKING:
    from shift3d.vehicles.mesh_frame import MeshFrame

FRAME_KEYS = ("forward", "up", "unit", "length_m")
_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
FRAME_VALUES = {"forward": _AXES, "up": _AXES, "unit": ("m", "cm", "mm", "in")}
"""Values for tab completion."""
FRAME_TEXT = """\
meshes: a PLY, OBJ, GLB or STL file, a folder of such files, or a folder in ShapeNet's layout
({synset}/{id}/models/model_normalized.obj). forward= and up= are axes of the files, by default ShapeNet's
forward=-z up=+y (glTF's are forward=+z up=+y). unit=m, cm, mm or in; for normalised meshes give length_m=4.5
instead. The command repairs a mesh that is not closed and reports the repair, or refuses the mesh."""


def mesh_frame(values: dict[str, str], where: str) -> MeshFrame:
    """Parse the orientation and scale in a command's words. Raises: InputError: an impossible frame."""
    from shift3d.vehicles.mesh_frame import MeshFrame

    frame: dict[str, str] = {key: values[key] for key in ("forward", "up", "unit") if key in values}
    frame = {key: value if key == "unit" or value[:1] in "+-" else f"+{value}" for key, value in frame.items()}
    return MeshFrame(**frame, length_m=real_number(values, "length_m", where, "4.5"))
