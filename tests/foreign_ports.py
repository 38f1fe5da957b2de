"""The shipped PointPillars and CenterPoint as checkpoints and configs of OpenPCDet and mmdetection3d.

The weights undo the differences of the codebases' computations, so that both give the same numbers:
- Their pillars are padded with points of zeros, which a bias would turn into features. The first layer's bias therefore
  is the weight of the intensity, a constant that points of zeros lack.
- Their origin is the sensor's: its height goes into that bias, and into the heights of anchors and boxes.
- CenterPoint's 3x3 convolutions use the centre alone. The shared convolution holds each output's function of the
  features, once plain and once negated: a difference undoes the ReLU between it and the outputs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import pi
from pathlib import Path

import torch
from torch import Tensor

from shift3d.detectors.foreign.config_common import ForeignOverrides
from shift3d.detectors.models.pillar_net import FEATURE_SCALE
from shift3d.detectors.models.weights import WEIGHTS_FOLDER, load_network

_NO_NORM = 1.0 - 1e-3  # variance of a norm that is the identity, with eps=1e-3
_NO_NORM_HEAD = 1.0 - 1e-5


@dataclass(frozen=True)
class Port:
    """codebase: "openpcdet" or "mmdet3d". shipped: the detector's name. height_m, intensity: of its data set."""

    codebase: str
    shipped: str
    data_set: str
    height_m: float
    intensity: float

    def __str__(self) -> str:
        return f"{self.codebase}-{self.shipped}"

    @property
    def choices(self) -> ForeignOverrides:
        """Overrides beside the config: Waymo's intensities are on an open scale."""
        return ForeignOverrides(intensity=self.intensity if self.data_set == "WaymoDataset" else None)

    def saved(self, folder: Path) -> tuple[Path, Path]:
        """Write config and checkpoint into a folder."""
        pcd = self.codebase == "openpcdet"
        net = load_network(WEIGHTS_FOLDER / f"{self.shipped}.safetensors", self.shipped).double()
        state = net.state_dict()
        anchor = [float(value) for value in state.get("heads.anchor_size_m", torch.zeros(3))]
        tensors = {**self._encoder(state), **self._backbone(state)}
        tensors |= self._anchors(state) if self.shipped == "pointpillars" else self._centres(state)
        tensors = {name: tensor.float() for name, tensor in tensors.items()}
        torch.save({"model_state" if pcd else "state_dict": tensors}, folder / "port.pth")
        config = folder / ("port.yaml" if pcd else "port.py")
        config.write_text(self._config(anchor))
        return config, folder / "port.pth"

    def _encoder(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        gain = state["pillar_net.norm.weight"] / torch.sqrt(state["pillar_net.norm.running_var"] + 1e-3)
        bias = state["pillar_net.norm.bias"] - state["pillar_net.norm.running_mean"] * gain
        weight = state["pillar_net.linear.weight"] * torch.tensor(FEATURE_SCALE) * gain[:, None]
        bias = (bias + weight[:, 2] * self.height_m) / self.intensity
        nothing = torch.zeros(len(bias), 1)
        name = "vfe" if self.codebase == "openpcdet" else "voxel_encoder"
        return {
            f"{name}.pfn_layers.0.linear.weight": torch.cat(
                (weight[:, :3], bias[:, None], weight[:, 3:], nothing), dim=1
            ),
            **_no_norm(f"{name}.pfn_layers.0.norm", len(bias), _NO_NORM),
        }

    def _backbone(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        blocks, ups, first = (
            ("backbone_2d.blocks", "backbone_2d.deblocks", 1)
            if self.codebase == "openpcdet"
            else ("backbone.blocks", "neck.deblocks", 0)
        )
        tensors = {}
        for name, tensor in state.items():
            if found := re.fullmatch(r"backbone\.(blocks|ups)\.(\d)\.(\d+)\.(.*)", name):
                part, block, layer, what = found.groups()
                there = f"{blocks}.{block}.{int(layer) + first}" if part == "blocks" else f"{ups}.{block}.{layer}"
                tensors[f"{there}.{what}"] = tensor
        return tensors

    def _anchors(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        head, boxes = ("dense_head", "conv_box") if self.codebase == "openpcdet" else ("bbox_head", "conv_reg")
        names = {"classes": "conv_cls", "boxes": boxes, "directions": "conv_dir_cls"}
        return {
            f"{head}.{there}.{what}": state[f"heads.{here}.{what}"]
            for here, there in names.items()
            for what in ("weight", "bias")
        }

    def _centres(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        pcd = self.codebase == "openpcdet"
        weight = torch.cat((state["heads.classes.weight"], state["heads.boxes.weight"]))
        bias = torch.cat((state["heads.classes.bias"], state["heads.boxes.bias"]))
        bias[1:3] += 0.5  # offsets of cells count from their corner
        bias[3] -= self.height_m
        count = len(bias)
        layer, norm = ("shared_conv.0", "shared_conv.1") if pcd else ("shared_conv.conv", "shared_conv.bn")
        head = "dense_head" if pcd else "bbox_head"
        tensors = {
            f"{head}.{layer}.weight": _centre_alone(torch.cat((weight, -weight))),
            **_no_norm(f"{head}.{norm}", 2 * count, _NO_NORM_HEAD),
        }
        difference = torch.cat((torch.eye(count), -torch.eye(count)), dim=1)[:, :, None, None].double()
        turn = [8, 7] if pcd else [7, 8]  # OpenPCDet stores the cosine first
        rows = dict(zip(_branches(pcd), ([0], [1, 2], [3], [4, 5, 6], turn), strict=True))
        for name, picked in rows.items():
            there = f"{head}.{'heads_list' if pcd else 'task_heads'}.0.{name}.0"
            tensors[f"{there}.weight"] = _centre_alone(difference[picked])
            tensors[f"{there}.bias"] = bias[picked]
        return tensors

    def _config(self, anchor: list[float]) -> str:
        bounds = [-74.88, -74.88, -2.0 - self.height_m, 74.88, 74.88, 4.0 - self.height_m]
        template = {
            ("openpcdet", "pointpillars"): _PCD + _PCD_ANCHORS,
            ("openpcdet", "centerpoint"): _PCD + _PCD_CENTRES,
            ("mmdet3d", "pointpillars"): _MM + _MM_ANCHORS + _MM_MODEL,
            ("mmdet3d", "centerpoint"): _MM + _MM_CENTRES + _MM_MODEL,
        }[self.codebase, self.shipped]
        ground = -self.height_m
        values = {"BOUNDS": bounds, "ANCHOR": anchor, "GROUND": ground, "SET": self.data_set, "QUARTER": pi / 4}
        for name, value in values.items():
            template = template.replace(f"<{name}>", str(value))
        return template


PORTS = {
    str(port): port
    for codebase, data_set, height_m, intensity in (
        ("openpcdet", "WaymoDataset", 0.0, 1.0),
        ("mmdet3d", "KittiDataset", 1.73, 0.27),
    )
    for shipped in ("pointpillars", "centerpoint")
    for port in (Port(codebase, shipped, data_set, height_m, intensity),)
}


def _no_norm(name: str, channels: int, variance: float) -> dict[str, Tensor]:
    ones, zeros = torch.ones(channels), torch.zeros(channels)
    return {
        f"{name}.weight": ones,
        f"{name}.bias": zeros,
        f"{name}.running_mean": zeros,
        f"{name}.running_var": variance * ones.double(),
    }


def _centre_alone(weight: Tensor) -> Tensor:
    """Return a 1x1 convolution's weight as that of a 3x3 convolution."""
    return torch.nn.functional.pad(weight, (1, 1, 1, 1))


def _branches(pcd: bool) -> tuple[str, ...]:
    """Return the names of heat map, offset, height, size and turn."""
    return ("hm", "center", "center_z", "dim", "rot") if pcd else ("heatmap", "reg", "height", "dim", "rot")


_PCD = """
CLASS_NAMES: [Vehicle]
DATA_CONFIG:
    DATASET: <SET>
    POINT_CLOUD_RANGE: <BOUNDS>
    POINT_FEATURE_ENCODING: {used_feature_list: [x, y, z, intensity]}
    DATA_PROCESSOR:
        - {NAME: transform_points_to_voxels, VOXEL_SIZE: [0.32, 0.32, 6.0], MAX_POINTS_PER_VOXEL: 100}
MODEL:
    VFE: {NAME: PillarVFE, WITH_DISTANCE: False, USE_ABSLOTE_XYZ: True, USE_NORM: True, NUM_FILTERS: [64]}
    MAP_TO_BEV: {NAME: PointPillarScatter, NUM_BEV_FEATURES: 64}
    BACKBONE_2D:
        NAME: BaseBEVBackbone
        LAYER_NUMS: [3, 5, 5]
        LAYER_STRIDES: [1, 2, 2]
        NUM_FILTERS: [64, 128, 256]
        UPSAMPLE_STRIDES: [1, 2, 4]
        NUM_UPSAMPLE_FILTERS: [128, 128, 128]
    POST_PROCESSING:
        NMS_CONFIG: {NMS_TYPE: nms_gpu, NMS_THRESH: 0.25}
"""
_PCD_ANCHORS = """
    NAME: PointPillar
    DENSE_HEAD:
        NAME: AnchorHeadSingle
        USE_DIRECTION_CLASSIFIER: True
        DIR_OFFSET: <QUARTER>
        DIR_LIMIT_OFFSET: 0.0
        NUM_DIR_BINS: 2
        ANCHOR_GENERATOR_CONFIG:
            - class_name: Vehicle
              anchor_sizes: [<ANCHOR>]
              anchor_rotations: [0, 1.5707963267948966]
              anchor_bottom_heights: [<GROUND>]
              align_center: True
              feature_map_stride: 1
        TARGET_ASSIGNER_CONFIG: {BOX_CODER: ResidualCoder}
"""
_PCD_CENTRES = """
    NAME: CenterPoint
    DENSE_HEAD:
        NAME: CenterHead
        CLASS_NAMES_EACH_HEAD: [[Vehicle]]
        SHARED_CONV_CHANNEL: 18
        NUM_HM_CONV: 1
        SEPARATE_HEAD_CFG:
            HEAD_DICT:
                center: {out_channels: 2, num_conv: 1}
                center_z: {out_channels: 1, num_conv: 1}
                dim: {out_channels: 3, num_conv: 1}
                rot: {out_channels: 2, num_conv: 1}
        TARGET_ASSIGNER_CONFIG: {FEATURE_MAP_STRIDE: 1}
        POST_PROCESSING:
            NMS_CONFIG: {NMS_TYPE: nms_gpu, NMS_THRESH: 0.25}
"""
_MM = """
dataset_type = '<SET>'
class_names = ['Car']
test_pipeline = [dict(type='LoadPointsFromFile', coord_type='LIDAR', load_dim=4, use_dim=4)]
bounds = <BOUNDS>
voxel_size = [0.32, 0.32, 6.0]
"""
_MM_ANCHORS = """
head = dict(
    type='Anchor3DHead', num_classes=1, use_direction_classifier=True, dir_offset=<QUARTER>,
    anchor_generator=dict(
        type='AlignedAnchor3DRangeGenerator', ranges=[[-74.88, -74.88, <GROUND>, 74.88, 74.88, <GROUND>]],
        sizes=[<ANCHOR>], rotations=[0, 1.5707963267948966]),
    bbox_coder=dict(type='DeltaXYZWLHRBBoxCoder'),
    loss_cls=dict(use_sigmoid=True))
"""
_MM_CENTRES = """
head = dict(
    type='CenterHead', tasks=[dict(num_class=1, class_names=['Car'])],
    common_heads=dict(reg=(2, 1), height=(1, 1), dim=(3, 1), rot=(2, 1)),
    share_conv_channel=18, num_heatmap_convs=1, norm_bbox=True,
    bbox_coder=dict(
        type='CenterPointBBoxCoder', pc_range=bounds[:2], out_size_factor=1, voxel_size=voxel_size[:2], code_size=7))
"""
_MM_MODEL = """
model = dict(
    data_preprocessor=dict(
        voxel_layer=dict(max_num_points=100, point_cloud_range=bounds, voxel_size=voxel_size)),
    voxel_encoder=dict(
        type='PillarFeatureNet', in_channels=4, feat_channels=[64], voxel_size=voxel_size, point_cloud_range=bounds,
        legacy=False),
    middle_encoder=dict(type='PointPillarsScatter', in_channels=64, output_shape=[468, 468]),
    backbone=dict(
        type='SECOND', in_channels=64, layer_nums=[3, 5, 5], layer_strides=[1, 2, 2], out_channels=[64, 128, 256]),
    neck=dict(
        type='SECONDFPN', in_channels=[64, 128, 256], upsample_strides=[1, 2, 4], out_channels=[128, 128, 128]),
    bbox_head=head,
    test_cfg=dict(nms_thr=0.25))
"""
