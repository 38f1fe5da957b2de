"""Small models in the configs of OpenPCDet and mmdetection3d, as their users would write them."""

from __future__ import annotations

from pathlib import Path

KITTI_RANGE = [0, -6.4, -3, 12.8, 6.4, 1]
WIDE_RANGE = [-6.4, -6.4, -5.0, 6.4, 6.4, 3.0]

_PCD_DATA = """
DATASET: '{data_set}'
POINT_CLOUD_RANGE: [0, -40, -3, 70.4, 40, 1]
POINT_FEATURE_ENCODING: {{
    encoding_type: absolute_coordinates_encoding,
    used_feature_list: {features},
    src_feature_list: {features},
}}
DATA_PROCESSOR:
    - NAME: mask_points_and_boxes_outside_range
      REMOVE_OUTSIDE_BOXES: True
"""

_PCD_ANCHOR = """            {{
                'class_name': '{name}',
                'anchor_sizes': [[{size}]],
                'anchor_rotations': [0, 1.57],
                'anchor_bottom_heights': [{bottom}],
                'align_center': {aligned},
                'feature_map_stride': 2,
                'matched_threshold': 0.6,
                'unmatched_threshold': 0.45
            }},
"""

_PCD_POINTPILLAR = """
CLASS_NAMES: ['Car', 'Pedestrian', 'Cyclist']

DATA_CONFIG:
    _BASE_CONFIG_: cfgs/dataset_configs/kitti_dataset.yaml
    POINT_CLOUD_RANGE: [0, -6.4, -3, 12.8, 6.4, 1]
    DATA_PROCESSOR:
        - NAME: transform_points_to_voxels
          VOXEL_SIZE: [0.4, 0.4, 4]
          MAX_POINTS_PER_VOXEL: 32
          MAX_NUMBER_OF_VOXELS: {{ 'train': 16000, 'test': 40000 }}

MODEL:
    NAME: PointPillar
    VFE:
        NAME: PillarVFE
        WITH_DISTANCE: False
        USE_ABSLOTE_XYZ: True
        USE_NORM: True
        NUM_FILTERS: [8]
    MAP_TO_BEV:
        NAME: PointPillarScatter
        NUM_BEV_FEATURES: 8
    BACKBONE_2D:
        NAME: BaseBEVBackbone
        LAYER_NUMS: [1, 1, 1]
        LAYER_STRIDES: [2, 2, 2]
        NUM_FILTERS: [8, 8, 8]
        UPSAMPLE_STRIDES: [1, 2, 4]
        NUM_UPSAMPLE_FILTERS: [8, 8, 8]
    DENSE_HEAD:
        NAME: AnchorHeadSingle
        CLASS_AGNOSTIC: False
        USE_DIRECTION_CLASSIFIER: True
        DIR_OFFSET: 0.78539
        DIR_LIMIT_OFFSET: 0.0
        NUM_DIR_BINS: 2
        ANCHOR_GENERATOR_CONFIG: [
{anchors}        ]
        TARGET_ASSIGNER_CONFIG:
            NAME: AxisAlignedTargetAssigner
            BOX_CODER: ResidualCoder
    POST_PROCESSING:
        SCORE_THRESH: 0.1
        NMS_CONFIG:
            MULTI_CLASSES_NMS: False
            NMS_TYPE: nms_gpu
            NMS_THRESH: 0.01
"""

_PCD_CENTERPOINT = """
CLASS_NAMES: {classes}

DATA_CONFIG:
    _BASE_CONFIG_: {base}
    POINT_CLOUD_RANGE: [-6.4, -6.4, -5.0, 6.4, 6.4, 3.0]
    DATA_PROCESSOR:
        - NAME: {step}
          VOXEL_SIZE: [0.4, 0.4, 8.0]
          MAX_POINTS_PER_VOXEL: 20

MODEL:
    NAME: CenterPoint
    VFE:
        NAME: {vfe}
        WITH_DISTANCE: False
        USE_ABSLOTE_XYZ: True
        USE_NORM: True
        NUM_FILTERS: {filters}
    MAP_TO_BEV:
        NAME: PointPillarScatter
        NUM_BEV_FEATURES: 8
    BACKBONE_2D:
        NAME: BaseBEVBackbone
        LAYER_NUMS: [1, 1, 1]
        LAYER_STRIDES: {strides}
        NUM_FILTERS: [8, 8, 8]
        UPSAMPLE_STRIDES: {ups}
        NUM_UPSAMPLE_FILTERS: [8, 8, 8]
    DENSE_HEAD:
        NAME: CenterHead
        CLASS_AGNOSTIC: False
        CLASS_NAMES_EACH_HEAD: {tasks}
        SHARED_CONV_CHANNEL: 6
        USE_BIAS_BEFORE_NORM: {biased}
        NUM_HM_CONV: 2
        SEPARATE_HEAD_CFG:
            HEAD_ORDER: ['center', 'center_z', 'dim', 'rot']
            HEAD_DICT: {{
                'center': {{'out_channels': 2, 'num_conv': 2}},
                'center_z': {{'out_channels': 1, 'num_conv': 2}},
                'dim': {{'out_channels': 3, 'num_conv': 2}},
                'rot': {{'out_channels': 2, 'num_conv': 2}},{vel}
            }}
        TARGET_ASSIGNER_CONFIG:
            FEATURE_MAP_STRIDE: {out}
        POST_PROCESSING:
            SCORE_THRESH: 0.1
            NMS_CONFIG:
                NMS_TYPE: nms_gpu
                NMS_THRESH: 0.7
"""

_MM_DATA = """
dataset_type = '{data_set}'
data_root = 'data/set/'
class_names = {classes}
test_pipeline = [
    dict(type='LoadPointsFromFile', coord_type='LIDAR', load_dim={load}, use_dim={load}, backend_args=None),
    dict(type='Pack3DDetInputs', keys=['points'])
]
metainfo = dict(classes=class_names)
"""

_MM_POINTPILLARS = """
voxel_size = [0.4, 0.4, 4]

model = dict(
    type='VoxelNet',
    data_preprocessor=dict(
        type='Det3DDataPreprocessor',
        voxel=True,
        voxel_layer=dict(
            max_num_points=32,
            point_cloud_range=[0, -6.4, -3, 12.8, 6.4, 1],
            voxel_size=voxel_size,
            max_voxels=(16000, 40000))),
    voxel_encoder=dict(
        type='PillarFeatureNet',
        in_channels=4,
        feat_channels=[8],
        with_distance=False,
        voxel_size=voxel_size,
        point_cloud_range=[0, -6.4, -3, 12.8, 6.4, 1]),
    middle_encoder=dict(type='PointPillarsScatter', in_channels=8, output_shape=[32, 32]),
    backbone=dict(type='SECOND', in_channels=8, layer_nums=[1, 1, 1], layer_strides=[2, 2, 2], out_channels=[8, 8, 8]),
    neck=dict(type='SECONDFPN', in_channels=[8, 8, 8], upsample_strides=[1, 2, 4], out_channels=[8, 8, 8]),
    bbox_head=dict(
        type='Anchor3DHead',
        num_classes=3,
        in_channels=24,
        feat_channels=24,
        use_direction_classifier=True,
        assign_per_class=True,
        anchor_generator=dict(
            type='AlignedAnchor3DRangeGenerator',
            ranges=[
                [0, -6.4, -0.6, 12.8, 6.4, -0.6],
                [0, -6.4, -0.6, 12.8, 6.4, -0.6],
                [0, -6.4, -1.78, 12.8, 6.4, -1.78],
            ],
            sizes=[[0.8, 0.6, 1.73], [1.76, 0.6, 1.73], [3.9, 1.6, 1.56]],
            rotations=[0, 1.57],
            reshape_out=False),
        diff_rad_by_sin=True,
        bbox_coder=dict(type='DeltaXYZWLHRBBoxCoder'),
        loss_cls=dict(type='mmdet.FocalLoss', use_sigmoid=True, gamma=2.0, alpha=0.25, loss_weight=1.0)),
    train_cfg=dict(allowed_border=0),
    test_cfg=dict(use_rotate_nms=True, nms_thr=0.01, score_thr=0.1, nms_pre=100, max_num=50))
"""

_MM_HARD = """
_base_ = './pointpillars.py'
voxel_size = [0.4, 0.4, 8]
bounds = [-6.4, -6.4, -5.0, 6.4, 6.4, 3.0]
test_pipeline = [
    dict(type='LoadPointsFromFile', coord_type='LIDAR', load_dim=5, use_dim=5),
    dict(type='LoadPointsFromMultiSweeps', sweeps_num=10),
]
dataset_type = 'NuScenesDataset'
model = dict(
    _delete_=True,
    type='MVXFasterRCNN',
    data_preprocessor=dict(
        voxel=True, voxel_layer=dict(max_num_points=20, point_cloud_range=bounds, voxel_size=voxel_size)),
    pts_voxel_encoder=dict(
        type='HardVFE', in_channels=4, feat_channels=[6, 8], with_distance=False, voxel_size=voxel_size,
        with_cluster_center=True, with_voxel_center=True, point_cloud_range=bounds,
        norm_cfg=dict(type='naiveSyncBN1d', eps=1e-3, momentum=0.01)),
    pts_middle_encoder=dict(type='PointPillarsScatter', in_channels=8, output_shape=[32, 32]),
    pts_backbone=dict(
        type='SECOND', in_channels=8, norm_cfg=dict(type='naiveSyncBN2d', eps=1e-3, momentum=0.01),
        layer_nums=[1, 1, 1], layer_strides=[2, 2, 2], out_channels=[8, 8, 8]),
    pts_neck=dict(
        type='SECONDFPN', norm_cfg=dict(type='naiveSyncBN2d', eps=1e-3, momentum=0.01), in_channels=[8, 8, 8],
        upsample_strides=[1, 2, 4], out_channels=[8, 8, 8]),
    pts_bbox_head=dict(
        type='Anchor3DHead', num_classes=3, in_channels=24, feat_channels=24, use_direction_classifier=True,
        anchor_generator=dict(
            type='Anchor3DRangeGenerator', ranges=[[-6.0, -6.0, -1.8, 6.0, 6.0, -1.8]],
            sizes=[[0.8, 0.6, 1.73], [1.76, 0.6, 1.73], [3.9, 1.6, 1.56]], custom_values=[0, 0],
            rotations=[0, 1.57], reshape_out=True),
        dir_offset=-0.7854,
        bbox_coder=dict(type='DeltaXYZWLHRBBoxCoder', code_size=9),
        loss_cls=dict(type='mmdet.FocalLoss', use_sigmoid=True)),
    test_cfg=dict(pts=dict(use_rotate_nms=True, nms_thr=0.2)))
"""

_MM_CENTERPOINT = """
voxel_size = [0.4, 0.4, 8]
model = dict(
    type='CenterPoint',
    data_preprocessor=dict(voxel=True, voxel_layer=dict(max_num_points=20, voxel_size=voxel_size)),
    pts_voxel_encoder=dict(
        type='PillarFeatureNet',
        in_channels=5,
        feat_channels=[8],
        with_distance=False,
        voxel_size=voxel_size,
        norm_cfg=dict(type='BN1d', eps=1e-3, momentum=0.01),
        legacy=False),
    pts_middle_encoder=dict(type='PointPillarsScatter', in_channels=8, output_shape=(32, 32)),
    pts_backbone=dict(
        type='SECOND', in_channels=8, out_channels=[8, 8, 8], layer_nums=[1, 1, 1], layer_strides=[2, 2, 2],
        norm_cfg=dict(type='BN', eps=1e-3, momentum=0.01), conv_cfg=dict(type='Conv2d', bias=False)),
    pts_neck=dict(
        type='SECONDFPN', in_channels=[8, 8, 8], out_channels=[8, 8, 8], upsample_strides=[0.5, 1, 2],
        norm_cfg=dict(type='BN', eps=1e-3, momentum=0.01), upsample_cfg=dict(type='deconv', bias=False),
        use_conv_for_no_stride=True),
    pts_bbox_head=dict(
        type='CenterHead',
        in_channels=sum([8, 8, 8]),
        tasks=[
            dict(num_class=2, class_names=['truck', 'construction_vehicle']),
            dict(num_class=2, class_names=['bus', 'car']),
        ],
        common_heads=dict(reg=(2, 2), height=(1, 2), dim=(3, 2), rot=(2, 2), vel=(2, 2)),
        share_conv_channel=64,
        bbox_coder=dict(
            type='CenterPointBBoxCoder', max_num=500, score_threshold=0.1, out_size_factor=4,
            voxel_size=voxel_size[:2], code_size=9),
        separate_head=dict(type='SeparateHead', init_bias=-2.19, final_kernel=3),
        norm_bbox=True),
    test_cfg=dict(pts=dict(nms_type='rotate', nms_thr=0.2)))
"""

_MM_CENTERPOINT_TOP = """
_base_ = ['../_base_/datasets/set.py', '../_base_/models/pillars.py']
point_cloud_range = [-6.4, -6.4, -5.0, 6.4, 6.4, 3.0]
data_prefix = dict(pts='samples/' + 'LIDAR_TOP')
model = dict(
    data_preprocessor=dict(voxel_layer=dict(point_cloud_range=point_cloud_range)),
    pts_voxel_encoder=dict(point_cloud_range=point_cloud_range),
    pts_bbox_head=dict(bbox_coder=dict(pc_range=point_cloud_range[:2])),
    test_cfg=dict(pts=dict(pc_range=point_cloud_range[:2])))
"""


def _written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def _pcd(folder: Path, data_set: str, features: list[str], base: str, text: str) -> Path:
    tools = folder / "tools"
    _written(tools / base, _PCD_DATA.format(data_set=data_set, features=features))
    return _written(tools / "cfgs" / "models" / "model.yaml", text)


def pcd_pointpillar(folder: Path, aligned: bool = False) -> Path:
    """Write OpenPCDet's PointPillar on KITTI's scale."""
    classes = {
        "Car": ("3.9, 1.6, 1.56", -1.78),
        "Pedestrian": ("0.8, 0.6, 1.73", -0.6),
        "Cyclist": ("1.76, 0.6, 1.73", -0.6),
    }
    anchors = "".join(
        _PCD_ANCHOR.format(name=name, size=size, bottom=bottom, aligned=aligned)
        for name, (size, bottom) in classes.items()
    )
    text = _PCD_POINTPILLAR.format(anchors=anchors)
    features = ["x", "y", "z", "intensity"]
    return _pcd(folder, "KittiDataset", features, "cfgs/dataset_configs/kitti_dataset.yaml", text)


def pcd_coarse(folder: Path) -> Path:
    """Write the same model with a map of anchors that is coarser than the backbone's coarsest."""
    path = pcd_pointpillar(folder, aligned=True)
    text = path.read_text().replace("[2, 2, 2]", "[1, 1, 2]").replace("[1, 2, 4]", "[0.25, 0.25, 0.5]")
    return _written(path, text.replace("'feature_map_stride': 2", "'feature_map_stride': 4"))


def pcd_centerpoint_waymo(folder: Path) -> Path:
    """Write OpenPCDet's CenterPoint on pillars for Waymo: two pillar layers, one head of three classes, biases."""
    base = "cfgs/dataset_configs/waymo_dataset.yaml"
    text = _PCD_CENTERPOINT.format(
        classes=["Pedestrian", "Vehicle", "Cyclist"], base=base, vfe="PillarVFE", filters=[8, 8], strides=[1, 2, 2],
        ups=[1, 2, 4], tasks=[["Pedestrian", "Vehicle", "Cyclist"]], biased=True, vel="", out=1,
        step="transform_points_to_voxels",
    )  # fmt: skip
    return _pcd(folder, "WaymoDataset", ["x", "y", "z", "intensity", "elongation"], base, text)


def pcd_centerpoint_nuscenes(folder: Path) -> Path:
    """Write OpenPCDet's CenterPoint on dynamic pillars for nuScenes: several heads, velocities, a coarser map."""
    base = "cfgs/dataset_configs/nuscenes_dataset.yaml"
    text = _PCD_CENTERPOINT.format(
        classes=["car", "truck", "bus"], base=base, vfe="DynPillarVFE", filters=[8], strides=[2, 2, 2],
        ups=[0.5, 1, 2], tasks=[["truck"], ["bus", "car"]], biased=False, out=4,
        vel="\n                'vel': {'out_channels': 2, 'num_conv': 2},",
        step="transform_points_to_voxels_placeholder",
    )  # fmt: skip
    return _pcd(folder, "NuScenesDataset", ["x", "y", "z", "intensity", "timestamp"], base, text)


def mm_pointpillars(folder: Path) -> Path:
    """Write mmdetection3d's PointPillars on KITTI's scale, legacy pillar features."""
    data = _MM_DATA.format(data_set="KittiDataset", classes=["Pedestrian", "Cyclist", "Car"], load=4)
    return _written(folder / "pointpillars.py", data + _MM_POINTPILLARS)


def mm_hard(folder: Path) -> Path:
    """Write mmdetection3d's PointPillars for nuScenes: two HardVFE layers, velocities, border-to-border anchors."""
    mm_pointpillars(folder)
    return _written(folder / "hard.py", _MM_HARD)


def mm_centerpoint(folder: Path) -> Path:
    """Write mmdetection3d's CenterPoint on pillars for nuScenes, in three files."""
    classes = ["car", "truck", "construction_vehicle", "bus"]
    _written(folder / "_base_/datasets/set.py", _MM_DATA.format(data_set="NuScenesDataset", classes=classes, load=5))
    _written(folder / "_base_/models/pillars.py", _MM_CENTERPOINT)
    return _written(folder / "centerpoint/model.py", _MM_CENTERPOINT_TOP)
