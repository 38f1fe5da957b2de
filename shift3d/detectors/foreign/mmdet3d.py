"""Reader of mmdetection3d's Python configs: PointPillars with one anchor head, and CenterPoint on pillars.

Source: mmdetection3d 1.0 to 1.4, mmdet3d/models: pillar_encoder, voxel_encoder, second, second_fpn, anchor3d_head,
centerpoint_head; anchor_3d_generator; delta_xyzwhlr_bbox_coder, centerpoint_bbox_coders. Boxes of 1.x have a bottom
centre and a heading counter-clockwise from +x; both coders use geometric centres, and so does this module.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

from shift3d.detectors.foreign.config_common import (
    ForeignOverrides,
    backbone_of,
    branch_names,
    channel_values,
    frame_of,
    grid_of,
    vehicle_class,
)
from shift3d.detectors.foreign.config_section import Section
from shift3d.detectors.foreign.layout import Anchor, AnchorHead, Branch, CentreHead, Layout, PillarInputs
from shift3d.detectors.foreign.python_config import read_python_config
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec

_CHANNELS = ("x", "y", "z", "intensity", "timestamp")
_BOX_BRANCHES = (("reg", 2), ("height", 1), ("dim", 3), ("rot", 2))
_GIVE = "Give the values of voxel_layer there, too: without them the encoder takes another grid's"


def mmdet3d_layout(path: Path, choices: ForeignOverrides) -> Layout:
    """Read the layout of a config. Raises InputError with the file and the value that is missing or not supported."""
    root = Section(read_python_config(path), str(path))
    model = root.section("model")
    prefix = "pts_" if model.has("pts_voxel_encoder") else ""
    model.absent("img_backbone", "img_neck", "rpn_head", "roi_head", "pts_fusion_layer", "backbone_3d")
    spec, plain_up, eps = _backbone(model, prefix)
    voxels = _voxels(model)
    bounds, size = voxels.numbers("point_cloud_range", 6), voxels.numbers("voxel_size", 3)
    grid = grid_of(bounds, size, spec, voxels)
    cells = grid.num_x // spec.out_stride, grid.num_y // spec.out_stride
    head = model.section(f"{prefix}bbox_head")
    head.expect("type", ("Anchor3DHead", "CenterHead"))
    if head.text("type") == "Anchor3DHead":
        made: AnchorHead | CentreHead = _anchors(head, _classes(root, head), choices, cells)
    else:
        made = _centre(head, choices, grid, spec)
    return Layout(
        source="mmdet3d",
        prefix=prefix,
        grid=grid,
        inputs=_inputs(model.section(f"{prefix}voxel_encoder"), root, bounds, voxels, choices),
        backbone=spec,
        plain_up=plain_up,
        backbone_eps=eps[0],
        neck_eps=eps[1],
        head=made,
        frame=frame_of(_data_set(root), choices, root),
        suppression_iou=_suppression(model, prefix),
    )


def _backbone(model: Section, prefix: str) -> tuple[BackboneSpec, bool, tuple[float, float]]:
    scatter, part, neck = (model.section(f"{prefix}{name}") for name in ("middle_encoder", "backbone", "neck"))
    scatter.expect("type", "PointPillarsScatter")
    part.expect("type", "SECOND")
    neck.expect("type", "SECONDFPN")
    widths = part.integers("out_channels", default=[128, 128, 256])
    if neck.integers("in_channels", default=[128, 128, 256]) != widths:
        neck.refuse(f"in_channels are not the backbone's {list(widths)}")
    spec = backbone_of(
        part,
        scatter.whole("in_channels"),
        part.integers("layer_nums", default=[3, 5, 5]),
        part.integers("layer_strides", default=[2, 2, 2]),
        widths,
        neck.numbers("upsample_strides", default=[1, 2, 4]),
        neck.integers("out_channels", default=[256, 256, 256]),
    )
    return spec, neck.flag("use_conv_for_no_stride", False), (_eps(part, 1e-3), _eps(neck, 1e-3))


def _eps(part: Section, default: float) -> float:
    """Return eps of a part's norms: torch's default if norm_cfg has no eps, the part's default without norm_cfg."""
    if not part.has("norm_cfg"):
        return default
    norm = part.section("norm_cfg")
    kinds = ("BN", "BN1d", "BN2d", "SyncBN", "naiveSyncBN1d", "naiveSyncBN2d")
    norm.expect("type", kinds)
    return norm.number("eps", 1e-5)


def _voxels(model: Section) -> Section:
    """Return the voxel layer: in the data preprocessor since 1.1, in the model before."""
    holder = model if model.has("voxel_layer") else model.section("data_preprocessor")
    holder.expect("voxel_type", "hard", "hard")
    return holder.section("voxel_layer")


def _inputs(
    part: Section, root: Section, bounds: tuple[float, ...], voxels: Section, choices: ForeignOverrides
) -> PillarInputs:
    part.expect("type", ("PillarFeatureNet", "HardVFE"))
    hard = part.text("type") == "HardVFE"
    part.expect("with_distance", False, False)
    for name in ("with_cluster_center", "with_voxel_center"):
        part.expect(name, True, not hard)
    part.expect("mode", "max", "max")
    part.absent("fusion_layer")
    for name in ("voxel_size", "point_cloud_range"):
        if not part.has(name) or part.numbers(name) != voxels.numbers(name):
            part.refuse(f"{name} is not that of voxel_layer", _GIVE)
    channels, filters = _channels(root, part.whole("in_channels", 4)), part.integers("feat_channels", default=[64])
    return PillarInputs(
        position="offset" if part.flag("legacy", not hard) else "coordinates",
        constants=channel_values(channels[3:], _data_set(root), choices, part),
        middle_m=(bounds[2] + bounds[5]) / 2,
        slots=voxels.whole("max_num_points"),
        # HardVFE lists only the per-point half of each layer's width.
        filters=(*(2 * width for width in filters[:-1]), filters[-1]) if hard else filters,
        named="vfe_layers" if hard else "pfn_layers",
        eps=_eps(part, 1e-3),
    )


def _channels(root: Section, count: int) -> tuple[str, ...]:
    """Return the channels of the model's points: those that test_pipeline loads, or the first columns without it."""
    columns: tuple[float, ...] = tuple(range(count))
    steps: Any = root.values.get("test_pipeline")
    for step in steps if isinstance(steps, list) else ():
        if isinstance(step, dict) and step.get("type") in ("LoadPointsFromFile", "LoadPointsFromMultiSweeps"):
            loader = Section(step, root.file, "test_pipeline")
            used = loader.get("use_dim", [0, 1, 2] if step["type"] == "LoadPointsFromFile" else [0, 1, 2, 4])
            columns = tuple(range(used)) if isinstance(used, int) else loader.numbers("use_dim", default=used)
    if len(columns) != count or columns[:3] != (0, 1, 2) or not set(columns) <= set(range(len(_CHANNELS))):
        shown = ", ".join(f"{column:g}" for column in columns)
        root.refuse(f"test_pipeline loads the columns {shown} for a model of {count} channels")
    return tuple(_CHANNELS[int(column)] for column in columns)


def _data_set(root: Section) -> str:
    return root.text("dataset_type", "")


def _classes(root: Section, head: Section) -> tuple[str, ...]:
    classes = root.texts("class_names") if root.has("class_names") else root.section("metainfo").texts("classes")
    if len(classes) != head.whole("num_classes"):
        head.refuse(f"num_classes is not that of class_names, {len(classes)}")
    return classes


def _suppression(model: Section, prefix: str) -> float | None:
    settings = model.section("test_cfg")
    settings = settings.section("pts") if prefix else settings
    return None if settings.get("nms_type", "rotate") == "circle" else settings.number("nms_thr")


def _anchors(head: Section, classes: tuple[str, ...], choices: ForeignOverrides, cells: tuple[int, int]) -> AnchorHead:
    head.expect("use_direction_classifier", True, True)
    head.expect("dir_limit_offset", (0, 0.0), 0)
    head.section("loss_cls").expect("use_sigmoid", True, False)
    coder = head.section("bbox_coder", {"type": "DeltaXYZWLHRBBoxCoder"})
    coder.expect("type", "DeltaXYZWLHRBBoxCoder")
    generator = head.section("anchor_generator")
    generator.expect("type", ("Anchor3DRangeGenerator", "AlignedAnchor3DRangeGenerator"))
    generator.expect("align_corner", False, False)
    generator.expect("scales", ([1], (1,)), [1])
    sizes, ranges = generator.sizes("sizes"), generator.rows("ranges", 6)
    if len(ranges) == 1:
        ranges = ranges * len(sizes)
    if len(ranges) != len(sizes):
        generator.refuse(f"{len(ranges)} ranges for {len(sizes)} sizes")
    aligned = generator.text("type").startswith("Aligned")
    return AnchorHead(
        anchors=tuple(
            _anchor(size, ends, heading, aligned, cells)
            for size, ends in zip(sizes, ranges, strict=True)
            for heading in generator.numbers("rotations", default=[0, 1.5707963])
        ),
        classes=len(classes),
        vehicle=classes.index(vehicle_class(classes, choices, head)),
        code_size=coder.whole("code_size", 7),
        direction_offset_rad=head.number("dir_offset", -pi / 2),
    )


def _anchor(
    size: tuple[float, float, float], ends: tuple[float, ...], heading: float, aligned: bool, cells: tuple[int, int]
) -> Anchor:
    """Make an anchor. Ranges give the height of its bottom; aligned anchors are centred in equal parts of the range."""
    insets = [(ends[axis + 3] - ends[axis]) / cells[axis] / 2 if aligned else 0.0 for axis in (0, 1)]
    bottom = (ends[2] + ends[5]) / 2 if aligned else ends[2]
    return Anchor(
        size_m=size,
        heading_rad=heading,
        z_m=bottom + size[2] / 2,
        x_m=(ends[0] + insets[0], ends[3] - insets[0]),
        y_m=(ends[1] + insets[1], ends[4] - insets[1]),
    )


def _centre(head: Section, choices: ForeignOverrides, grid: Grid, spec: BackboneSpec) -> CentreHead:
    head.expect("norm_bbox", True, True)
    head.expect("dcn_head", False, False)
    separate = head.section("separate_head", {"type": "SeparateHead", "final_kernel": 3})
    separate.expect("type", "SeparateHead")
    separate.expect("final_kernel", 3, 1)
    coder = head.section("bbox_coder")
    coder.expect("type", "CenterPointBBoxCoder")
    coder.expect("out_size_factor", spec.out_stride)
    origin, cell = (grid.x_min_m, grid.y_min_m), (grid.cell_m, grid.cell_m)
    if coder.numbers("pc_range")[:2] != origin or coder.numbers("voxel_size")[:2] != cell:
        coder.refuse(f"pc_range and voxel_size are not the voxel layer's, {list(origin)} and {list(cell)}")
    tasks = [part.texts("class_names") for part in head.sections("tasks")]
    vehicle = vehicle_class([name for names in tasks for name in names], choices, head)
    task = next(index for index, names in enumerate(tasks) if vehicle in names)
    return CentreHead(
        tasks=tuple(map(len, tasks)),
        task=task,
        vehicle=tasks[task].index(vehicle),
        branches=tuple(_branches(head.section("common_heads"))),
        heat=Branch(name="heatmap", outputs=1, layers=head.whole("num_heatmap_convs", 2)),
        shared=head.whole("share_conv_channel", 64),
        hidden=separate.whole("head_conv", 64),
        biased=False,
        sine_first=True,
        eps=_eps(head, 1e-5),
    )


def _branches(table: Section) -> list[Branch]:
    """Read the box branches: offset, height, size and heading first. The config has (outputs, layers) of each."""
    found = {name: table.integers(name, 2) for name in branch_names(table, [name for name, _ in _BOX_BRANCHES])}
    for name, wanted in _BOX_BRANCHES:
        if found[name][0] != wanted:
            table.refuse(f"{name} has {found[name][0]} outputs, not {wanted}")
    return [Branch(name=name, outputs=outputs, layers=layers) for name, (outputs, layers) in found.items()]
