"""Reader of OpenPCDet's YAML configs: PointPillar with one anchor head, and CenterPoint on pillars.

Source: OpenPCDet 0.3 to 0.6: pillar_vfe, dynamic_pillar_vfe, base_bev_backbone, anchor_head_single, center_head.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from shift3d.detectors.foreign.config_common import (
    ForeignOverrides,
    backbone_of,
    branch_names,
    channel_values,
    frame_of,
    grid_of,
    vehicle_class,
)
from shift3d.detectors.foreign.config_section import Section, merged
from shift3d.detectors.foreign.layout import Anchor, AnchorHead, Branch, CentreHead, Layout, PillarInputs
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec
from shift3d.errors import InputError

_BASE = "_BASE_CONFIG_"
_FAR_M = 1e6
_BOX_BRANCHES = (("center", 2), ("center_z", 1), ("dim", 3), ("rot", 2))


def read_yaml(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a config merged over its `_BASE_CONFIG_` files: tables are merged, other values are replaced.

    Base paths are searched relative to the config's folder and its parents (OpenPCDet: relative to tools/), then by
    file name beside the config. above: the files that it is a base of. Raises InputError if a file is missing or not
    YAML, or is a base of itself.
    """
    if (file := path.resolve()) in above:
        raise InputError(f"{_BASE} leads back to it", str(path), "Remove the circle")
    try:
        content = yaml.safe_load(path.read_text())
        if not isinstance(content, dict):
            raise InputError("holds no table", str(path), "Give the model's YAML of OpenPCDet")
        return _with_bases(content, path, (*above, file))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:  # an alias may hold itself
        raise InputError(f"no readable YAML: {str(error)[:200]}", str(path), "Check detector.config") from error


def _with_bases(values: dict[str, Any], path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    name = values.get(_BASE)
    under = {} if name is None else read_yaml(_base_file(str(name), path), above)
    tables = {key: _with_bases(value, path, above) for key, value in values.items() if isinstance(value, dict)}
    return merged(under, {key: tables.get(key, value) for key, value in values.items() if key != _BASE})


def _base_file(name: str, path: Path) -> Path:
    folder = path.absolute().parent
    places = [*(above / name for above in (folder, *folder.parents)), folder / Path(name).name]
    for place in places:
        if place.is_file() and not (path.is_file() and place.samefile(path)):
            return place
    raise InputError(f"{_BASE} {name} is nowhere above it or beside it", str(path), "Copy it beside the config")


def openpcdet_layout(path: Path, choices: ForeignOverrides) -> Layout:
    """Read the layout of a config. Raises InputError with the file and the value that is missing or not supported."""
    root = Section(read_yaml(path), str(path))
    data, model = root.section("DATA_CONFIG"), root.section("MODEL")
    model.expect("NAME", ("PointPillar", "CenterPoint"))
    model.absent("BACKBONE_3D", "PFE", "POINT_HEAD", "ROI_HEAD")
    spec, plain_up = _backbone(model)
    voxels, bounds = _voxels(data), data.numbers("POINT_CLOUD_RANGE", 6)
    grid = grid_of(bounds, voxels.numbers("VOXEL_SIZE", 3), spec, data)
    inputs = _inputs(model.section("VFE"), data, voxels, grid, choices)
    if inputs.slots is None:  # dynamic encoders keep points above and below the range
        grid = Grid(grid.x_min_m, grid.y_min_m, -_FAR_M, _FAR_M, grid.cell_m, grid.num_x, grid.num_y)
    head = model.section("DENSE_HEAD")
    head.expect("NAME", ("AnchorHeadSingle", "CenterHead"))
    classes = root.texts("CLASS_NAMES")
    vehicle = vehicle_class(classes, choices, root)
    anchors = head.text("NAME") == "AnchorHeadSingle"
    settings = (model if anchors else head).section("POST_PROCESSING").section("NMS_CONFIG")
    by_distance = settings.get("NMS_TYPE", "") == "circle_nms"
    return Layout(
        source="openpcdet",
        grid=grid,
        inputs=inputs,
        backbone=spec,
        plain_up=plain_up,
        head=_anchors(head, classes, vehicle, bounds, spec, grid) if anchors else _centre(head, classes, vehicle, spec),
        frame=frame_of(data.text("DATASET", ""), choices, data),
        suppression_iou=None if by_distance else settings.number("NMS_THRESH"),
    )


def _backbone(model: Section) -> tuple[BackboneSpec, bool]:
    scatter, part = model.section("MAP_TO_BEV"), model.section("BACKBONE_2D")
    scatter.expect("NAME", "PointPillarScatter")
    part.expect("NAME", "BaseBEVBackbone")
    spec = backbone_of(
        part,
        scatter.whole("NUM_BEV_FEATURES"),
        part.integers("LAYER_NUMS"),
        part.integers("LAYER_STRIDES"),
        part.integers("NUM_FILTERS"),
        part.numbers("UPSAMPLE_STRIDES"),
        part.integers("NUM_UPSAMPLE_FILTERS"),
    )
    return spec, part.flag("USE_CONV_FOR_NO_STRIDE", False)


def _voxels(data: Section) -> Section:
    steps = data.sections("DATA_PROCESSOR")
    names = ("transform_points_to_voxels", "transform_points_to_voxels_placeholder")
    found = [step for step in steps if step.text("NAME") in names]
    if len(found) != 1:
        data.refuse(f"DATA_PROCESSOR has {len(found)} steps transform_points_to_voxels")
    return found[0]


def _inputs(part: Section, data: Section, voxels: Section, grid: Grid, choices: ForeignOverrides) -> PillarInputs:
    part.expect("NAME", ("PillarVFE", "DynPillarVFE", "DynamicPillarVFE"))
    part.expect("WITH_DISTANCE", False)
    part.expect("USE_NORM", True)
    encoding = data.section("POINT_FEATURE_ENCODING")
    names = encoding.texts("used_feature_list")
    if names[:3] != ("x", "y", "z"):
        encoding.refuse(f"used_feature_list begins with {', '.join(names[:3])}, not x, y, z")
    return PillarInputs(
        position="coordinates" if part.flag("USE_ABSLOTE_XYZ") else "none",
        constants=channel_values(names[3:], data.text("DATASET", ""), choices, encoding),
        middle_m=(grid.z_min_m + grid.z_max_m) / 2,
        slots=voxels.whole("MAX_POINTS_PER_VOXEL") if part.text("NAME") == "PillarVFE" else None,
        filters=part.integers("NUM_FILTERS"),
    )


def _anchors(
    head: Section, classes: tuple[str, ...], vehicle: str, bounds: tuple[float, ...], spec: BackboneSpec, grid: Grid
) -> AnchorHead:
    head.expect("CLASS_AGNOSTIC", False, False)
    head.expect("USE_DIRECTION_CLASSIFIER", True)
    head.expect("NUM_DIR_BINS", 2)
    head.expect("DIR_LIMIT_OFFSET", (0, 0.0))
    coder = head.section("TARGET_ASSIGNER_CONFIG")
    coder.expect("BOX_CODER", "ResidualCoder")
    code = coder.section("BOX_CODER_CONFIG", {})
    code.expect("encode_angle_by_sincos", False, False)
    anchors: list[Anchor] = []
    for part in head.sections("ANCHOR_GENERATOR_CONFIG"):
        part.expect("feature_map_stride", spec.out_stride)
        anchors += _anchors_of(part, bounds, spec, grid)
    return AnchorHead(
        anchors=tuple(anchors),
        classes=len(classes),
        vehicle=classes.index(vehicle),
        code_size=code.whole("code_size", 7),
        direction_offset_rad=head.number("DIR_OFFSET"),
    )


def _anchors_of(part: Section, bounds: tuple[float, ...], spec: BackboneSpec, grid: Grid) -> list[Anchor]:
    """Return the anchors of one class: in the centres of cells, or spaced from one border of the range to the other."""
    (bottom,) = part.numbers("anchor_bottom_heights", 1)
    inset = grid.cell_m * spec.out_stride / 2 if part.flag("align_center", False) else 0.0
    return [
        Anchor(
            size_m=size,
            heading_rad=heading,
            z_m=bottom + size[2] / 2,
            x_m=(bounds[0] + inset, bounds[3] - inset),
            y_m=(bounds[1] + inset, bounds[4] - inset),
        )
        for size in part.sizes("anchor_sizes")
        for heading in part.numbers("anchor_rotations")
    ]


def _centre(head: Section, classes: tuple[str, ...], vehicle: str, spec: BackboneSpec) -> CentreHead:
    each = [Section({"names": names}, head.file, head.path) for names in head.sequence("CLASS_NAMES_EACH_HEAD")]
    tasks = [tuple(name for name in part.texts("names") if name in classes) for part in each]
    if sorted(name for names in tasks for name in names) != sorted(classes):
        head.refuse("CLASS_NAMES_EACH_HEAD does not name each of CLASS_NAMES once")
    head.section("TARGET_ASSIGNER_CONFIG").expect("FEATURE_MAP_STRIDE", spec.out_stride)
    separate = head.section("SEPARATE_HEAD_CFG")
    table = separate.section("HEAD_DICT")
    parts = {name: table.section(name) for name in branch_names(table, [name for name, _ in _BOX_BRANCHES])}
    for name, outputs in _BOX_BRANCHES:
        parts[name].expect("out_channels", outputs)
    branches = [
        Branch(name=name, outputs=part.whole("out_channels"), layers=part.whole("num_conv"))
        for name, part in parts.items()
    ]
    shared = head.whole("SHARED_CONV_CHANNEL")
    task = next(index for index, names in enumerate(tasks) if vehicle in names)
    return CentreHead(
        tasks=tuple(map(len, tasks)),
        task=task,
        vehicle=tasks[task].index(vehicle),
        branches=tuple(branches),
        heat=Branch(name="hm", outputs=1, layers=head.whole("NUM_HM_CONV")),
        shared=shared,
        hidden=shared,
        biased=head.flag("USE_BIAS_BEFORE_NORM", False),
        sine_first=False,
        eps=head.number("BN_EPS", 1e-5),
    )
