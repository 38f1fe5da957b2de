"""What both codebases' configs say in the same way: grid, strides, the kept class, and what a data set implies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shift3d.detectors.foreign.layout import Frame
from shift3d.detectors.foreign.values import Section
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec

VEHICLE_CLASSES = ("Car", "car", "Vehicle", "vehicle")


@dataclass(frozen=True)
class _DataSet:
    """height_m: of the points' origin above the ground. turned: see `Frame`. intensity: of all, in the files' units."""

    height_m: float
    turned: bool
    intensity: float | None


# Heights: KITTI's setup page; the LIDAR_TOP calibration of nuScenes; Waymo's vehicle frame stands on the ground.
# Intensities: medians of 20 frames of KITTI and of one of nuScenes. Waymo's is an open scale: it has to be given.
_DATA_SETS = {
    "KittiDataset": _DataSet(1.73, False, 0.27),
    "NuScenesDataset": _DataSet(1.84, True, 12.0),
    "WaymoDataset": _DataSet(0.0, False, None),
}


@dataclass(frozen=True)
class Choices:
    """What a user says beside the config; None: as the config and its data set say.

    vehicle_class: the class that is kept. sensor_height_m: of the model's origin above the ground. intensity: that
    every point is given, in the model's units.
    """

    vehicle_class: str | None = None
    sensor_height_m: float | None = None
    intensity: float | None = None


def vehicle_class(classes: Sequence[str], choices: Choices, section: Section) -> str:
    """The class that is kept. Raises InputError: there is none of that name."""
    wanted = (choices.vehicle_class,) if choices.vehicle_class else VEHICLE_CLASSES
    found = [name for name in wanted if name in classes]
    if not found:
        what = f"no class {' or '.join(wanted)} among {', '.join(classes)}"
        section.refuse(what, "Choose one of them: detector.vehicle_class=NAME")
    return found[0]


def frame_of(data_set: str, choices: Choices, section: Section) -> Frame:
    """The model's frame. Raises InputError: a data set whose sensor height is not known."""
    known = _DATA_SETS.get(data_set)
    height = choices.sensor_height_m if choices.sensor_height_m is not None else known.height_m if known else None
    if height is None:
        what = f"how high the origin of {data_set or 'its data set'} is above the ground is not known"
        section.refuse(what, "Give detector.sensor_height_m=METRES")
    return Frame(height_m=height, turned=known is not None and known.turned)


def channel_values(channels: Sequence[str], data_set: str, choices: Choices, section: Section) -> tuple[float, ...]:
    """A constant for each channel beside coordinates: the intensity, and 0 for times and elongations.

    Raises InputError: another channel, or an intensity that is not known.
    """
    known = _DATA_SETS.get(data_set)
    intensity = choices.intensity if choices.intensity is not None else known.intensity if known else None
    values = {"intensity": intensity, "elongation": 0.0, "timestamp": 0.0}
    for name in channels:
        if name not in values:
            section.refuse(f"points have a channel {name!r}")
        if values[name] is None:
            what = f"the intensities of {data_set or 'its data set'} are not known, and the model reads them"
            section.refuse(what, "Give detector.intensity=VALUE, which every point is given")
    return tuple(value for name in channels if (value := values[name]) is not None)


def branch_names(table: Section, boxes: Sequence[str]) -> list[str]:
    """Names of a centre head's branches: those of boxes first. Raises InputError: another than these and "vel"."""
    if surplus := sorted(set(table.values) - {*boxes, "vel"}):
        table.refuse(f"a branch {surplus[0]!r}")
    return [*boxes, *(["vel"] if table.has("vel") else [])]


def grid_of(bounds: Sequence[float], voxel: Sequence[float], spec: BackboneSpec, section: Section) -> Grid:
    """The grid of a range (x, y, z, x, y, z) and a voxel, metres.

    Raises InputError: voxels that are not pillars, not square, do not fill the range, or do not fit the strides.
    """
    counts = [(bounds[axis + 3] - bounds[axis]) / voxel[axis] if voxel[axis] > 0 else 0.0 for axis in range(3)]
    if any(abs(count - round(count)) > 1e-3 or round(count) < 1 for count in counts):
        section.refuse(f"voxels {list(voxel)} do not fill the range {list(bounds)}")
    if round(counts[2]) != 1 or abs(voxel[0] - voxel[1]) > 1e-9:
        section.refuse(f"voxels {list(voxel)} are no square pillars of the range's whole height")
    stride = spec.coarsest_stride
    if any(round(count) % stride for count in counts[:2]):
        section.refuse(
            f"{round(counts[0])} x {round(counts[1])} pillars are no multiple of the backbone's stride {stride}"
        )
    return Grid(bounds[0], bounds[1], bounds[2], bounds[5], voxel[0], round(counts[0]), round(counts[1]))


def backbone_of(
    section: Section, channels: int, layers: Sequence[int], strides: Sequence[int], widths: Sequence[int],
    up_strides: Sequence[float], up_widths: Sequence[int],
) -> BackboneSpec:  # fmt: skip
    """The backbone and its upsampling. Raises InputError: its maps do not meet, or have several widths."""
    if len({len(part) for part in (layers, strides, widths, up_strides, up_widths)}) != 1:
        section.refuse("layers, strides, widths and upsampling are not of the same number")
    spec = BackboneSpec(channels, tuple(strides), tuple(layers), tuple(widths), up_widths[0])
    outputs = {total / up if up > 0 else 0.0 for total, up in zip(spec.total_strides, up_strides, strict=True)}
    if len(outputs) != 1 or min(outputs) < 1 or min(outputs) != round(min(outputs)):
        section.refuse(f"upsampling by {list(up_strides)} does not bring strides {list(strides)} to one map")
    if len(set(up_widths)) != 1:
        section.refuse(f"upsampled to {list(up_widths)} channels, not to one number of them")
    return BackboneSpec(channels, spec.strides, spec.layers, spec.channels, spec.up_channels, round(min(outputs)))
