"""Common parts of both codebases' configs: grid, strides, vehicle class, and defaults per data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shift3d.detectors.foreign.config_section import Section
from shift3d.detectors.foreign.layout import Frame
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec

VEHICLE_CLASSES = ("Car", "car", "Vehicle", "vehicle")


@dataclass(frozen=True)
class _DataSet:
    """Defaults. height_m: of the points' origin above ground. turned: see `Frame`. intensity: constant, file units."""

    height_m: float
    turned: bool
    intensity: float | None


# Heights: KITTI's setup page; the LIDAR_TOP calibration of nuScenes; the origin of Waymo's vehicle frame is on the
# ground. Intensities: medians of 20 frames of KITTI and of one of nuScenes. Waymo's scale is open: the user sets it.
_DATA_SETS = {
    "KittiDataset": _DataSet(1.73, False, 0.27),
    "NuScenesDataset": _DataSet(1.84, True, 12.0),
    "WaymoDataset": _DataSet(0.0, False, None),
}


@dataclass(frozen=True)
class ForeignOverrides:
    """User settings that override the config and the defaults of its data set; None: no override.

    vehicle_class: class to keep. sensor_height_m: height of the model's origin above the ground. intensity: constant
    for all points, in the model's units.
    """

    vehicle_class: str | None = None
    sensor_height_m: float | None = None
    intensity: float | None = None


def vehicle_class(classes: Sequence[str], choices: ForeignOverrides, section: Section) -> str:
    """Return the class to keep. Raises InputError if the model has no class of that name."""
    wanted = (choices.vehicle_class,) if choices.vehicle_class else VEHICLE_CLASSES
    found = [name for name in wanted if name in classes]
    if not found:
        what = f"no class {' or '.join(wanted)} among {', '.join(classes)}"
        section.refuse(what, "Choose one of them: detector.vehicle_class=NAME")
    return found[0]


def frame_of(data_set: str, choices: ForeignOverrides, section: Section) -> Frame:
    """Return the model's frame. Raises InputError if the sensor height of the data set is unknown."""
    known = _DATA_SETS.get(data_set)
    height = choices.sensor_height_m if choices.sensor_height_m is not None else known.height_m if known else None
    if height is None:
        what = f"how high the origin of {data_set or 'its data set'} is above the ground is not known"
        section.refuse(what, "Give detector.sensor_height_m=METRES")
    return Frame(height_m=height, turned=known is not None and known.turned)


def channel_values(
    channels: Sequence[str], data_set: str, choices: ForeignOverrides, section: Section
) -> tuple[float, ...]:
    """Return a constant for each channel other than coordinates: the intensity, and 0 for timestamp and elongation.

    Raises InputError for another channel or an unknown intensity.
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
    """Return the branch names of a centre head, boxes first. Raises InputError for other names than these and "vel"."""
    if surplus := sorted(set(table.values) - {*boxes, "vel"}):
        table.refuse(f"a branch {surplus[0]!r}")
    return [*boxes, *(["vel"] if table.has("vel") else [])]


def grid_of(bounds: Sequence[float], voxel: Sequence[float], spec: BackboneSpec, section: Section) -> Grid:
    """Make the grid of a range (x, y, z, x, y, z) and a voxel size, metres.

    Raises InputError if voxels are not pillars, not square, do not fill the range, or do not fit the strides.
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
    """Make the backbone spec. Raises InputError if the upsampled maps have different strides or widths."""
    if len({len(part) for part in (layers, strides, widths, up_strides, up_widths)}) != 1:
        section.refuse("layers, strides, widths and upsampling are not of the same number")
    spec = BackboneSpec(channels, tuple(strides), tuple(layers), tuple(widths), up_widths[0])
    outputs = {total / up if up > 0 else 0.0 for total, up in zip(spec.total_strides, up_strides, strict=True)}
    if len(outputs) != 1 or min(outputs) < 1 or min(outputs) != round(min(outputs)):
        section.refuse(f"upsampling by {list(up_strides)} does not bring strides {list(strides)} to one map")
    if len(set(up_widths)) != 1:
        section.refuse(f"upsampled to {list(up_widths)} channels, not to one number of them")
    return BackboneSpec(channels, spec.strides, spec.layers, spec.channels, spec.up_channels, round(min(outputs)))
