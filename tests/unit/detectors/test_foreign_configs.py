"""Configs of other codebases are read as data; unsupported entries are refused with file and name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from foreign_cases import CASES
from foreign_configs import mm_centerpoint, mm_pointpillars, pcd_pointpillar

from shift3d.detectors.foreign.config_common import ForeignOverrides
from shift3d.detectors.foreign.config_section import UnevaluatedExpression
from shift3d.detectors.foreign.detector import foreign_layout
from shift3d.detectors.foreign.python_config import read_python_config
from shift3d.errors import InputError


def layout(name: str, path: Path, **choices: Any) -> dict[str, Any]:
    return foreign_layout(name, path, ForeignOverrides(**choices))


def refused(name: str, path: Path, **choices: Any) -> InputError:
    with pytest.raises(InputError) as caught:
        layout(name, path, **choices)
    assert caught.value.remedy and caught.value.where and "\n" not in str(caught.value)
    return caught.value


PCD = [
    ("NAME: PointPillar\n", "NAME: PVRCNN\n", "PVRCNN"),
    ("NAME: PillarVFE", "NAME: MeanVFE", "MeanVFE"),
    ("WITH_DISTANCE: False", "WITH_DISTANCE: True", "WITH_DISTANCE"),
    ("USE_NORM: True", "USE_NORM: False", "USE_NORM"),
    ("NAME: AnchorHeadSingle", "NAME: AnchorHeadMulti", "AnchorHeadMulti"),
    ("USE_DIRECTION_CLASSIFIER: True", "USE_DIRECTION_CLASSIFIER: False", "USE_DIRECTION_CLASSIFIER"),
    ("NUM_DIR_BINS: 2", "NUM_DIR_BINS: 4", "NUM_DIR_BINS"),
    ("BOX_CODER: ResidualCoder", "BOX_CODER: PointResidualCoder", "BOX_CODER"),
    ("UPSAMPLE_STRIDES: [1, 2, 4]", "UPSAMPLE_STRIDES: [1, 2, 2]", "one map"),
    ("NUM_UPSAMPLE_FILTERS: [8, 8, 8]", "NUM_UPSAMPLE_FILTERS: [8, 8, 16]", "channels"),
    ("LAYER_STRIDES: [2, 2, 2]", "LAYER_STRIDES: [2, 2]", "same number"),
    ("VOXEL_SIZE: [0.4, 0.4, 4]", "VOXEL_SIZE: [0.4, 0.4, 2]", "whole height"),
    ("VOXEL_SIZE: [0.4, 0.4, 4]", "VOXEL_SIZE: [0.4, 0.2, 4]", "square"),
    ("VOXEL_SIZE: [0.4, 0.4, 4]", "VOXEL_SIZE: [0.3, 0.3, 4]", "fill the range"),
    ("VOXEL_SIZE: [0.4, 0.4, 4]", "VOXEL_SIZE: [0.8, 0.8, 4]", None),
    ("    MAP_TO_BEV:", "    BACKBONE_3D:\n        NAME: VoxelBackBone8x\n    MAP_TO_BEV:", "BACKBONE_3D"),
    ("    POST_PROCESSING:", "    ROI_HEAD:\n        NAME: PVRCNNHead\n    POST_PROCESSING:", "ROI_HEAD"),
    ("'feature_map_stride': 2", "'feature_map_stride': 1", "feature_map_stride"),
    ("'anchor_bottom_heights': [-1.78]", "'anchor_bottom_heights': [-1.78, 0.0]", "anchor_bottom_heights"),
    ("['Car', 'Pedestrian', 'Cyclist']", "['Van', 'Pedestrian', 'Cyclist']", "no class Car"),
    ("MAX_POINTS_PER_VOXEL: 32", "MAX_POINTS_PER_VOXEL: many", "MAX_POINTS_PER_VOXEL"),
    ("NUM_FILTERS: [8]", "NUM_FILTER: [8]", "NUM_FILTERS is missing"),
    ("'anchor_sizes': [[3.9,", "'anchor_sizes': [[-3.9,", "anchor_sizes"),
]


@pytest.mark.parametrize(("there", "instead", "says"), PCD)
def test_what_openpcdet_has_beyond(there: str, instead: str, says: str | None, tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    text = path.read_text()
    assert there in text
    path.write_text(text.replace(there, instead))
    if says is None:
        assert layout("openpcdet", path)["grid"]["num_x"] == 16
    else:
        error = refused("openpcdet", path)
        assert says in str(error) and error.where == str(path)


def test_points_with_a_channel_of_their_own(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    base = tmp_path / "tools/cfgs/dataset_configs/kitti_dataset.yaml"
    base.write_text(base.read_text().replace("'intensity']", "'ring']"))
    assert "'ring'" in str(refused("openpcdet", path))


def test_a_base_is_found_beside_the_config_too_and_named_where_it_is_nowhere(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    base = tmp_path / "tools/cfgs/dataset_configs/kitti_dataset.yaml"
    expected = layout("openpcdet", path)
    base.rename(path.parent / "kitti_dataset.yaml")
    assert layout("openpcdet", path) == expected
    (path.parent / "kitti_dataset.yaml").unlink()
    assert "cfgs/dataset_configs/kitti_dataset.yaml" in str(refused("openpcdet", path))


def test_tables_of_a_base_are_merged_and_all_else_replaced(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    found = layout("openpcdet", path)  # the range is the config's, the features are the base's
    assert found["grid"]["num_x"] == 32 and found["inputs"]["constants"] == [0.27]


def test_bases_that_lead_back_to_their_config_are_named(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    base = tmp_path / "tools/cfgs/dataset_configs/kitti_dataset.yaml"
    base.write_text(f"{base.read_text()}\n_BASE_CONFIG_: {path.relative_to(tmp_path / 'tools')}\n")
    error = refused("openpcdet", path)
    assert "leads back to it" in error.what and error.where == str(path) and "circle" in str(error.remedy)


def test_a_table_that_holds_itself_is_refused(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    path.write_text(path.read_text() + "\nHOOK: &hook\n    INNER: *hook\n")
    assert "no readable YAML" in str(refused("openpcdet", path))


def test_yaml_makes_no_objects(tmp_path: Path) -> None:
    path = pcd_pointpillar(tmp_path)
    path.write_text(path.read_text() + "\nHOOK: !!python/object/apply:os.getcwd []\n")
    assert "no readable YAML" in str(refused("openpcdet", path))


MM = [
    ("type='PillarFeatureNet'", "type='HardVFE'", "with_cluster_center"),
    ("type='PillarFeatureNet'", "type='DynamicVFE'", "DynamicVFE"),
    ("type='SECONDFPN'", "type='FPN'", "FPN"),
    ("type='AlignedAnchor3DRangeGenerator'", "type='AnchorGenerator'", "AnchorGenerator"),
    ("use_sigmoid=True", "use_sigmoid=False", "use_sigmoid"),
    ("num_classes=3", "num_classes=4", "num_classes"),
    ("in_channels=4", "in_channels=5", "the columns 0, 1, 2, 3 for a model of 5"),
    ("use_dim=4", "use_dim=None", "use_dim is None, not a list"),
    ("use_dim=4", "use_dim=[0, 1, 2, [3]]", r"use_dim is \[3\], not a finite number"),
    ("use_dim=4", "use_dim=[0, 1, 2, 2.5]", "the columns 0, 1, 2, 2.5 for a model of 4"),
    ("voxel_size=voxel_size,\n        point_cloud_range", "point_cloud_range", "voxel_size"),
    ("    backbone=dict(", "    img_backbone=dict(type='ResNet'),\n    backbone=dict(", "img_backbone"),
    ("with_distance=False", "with_distance=True", "with_distance"),
    ("nms_thr=0.01", "nms_threshold=0.01", "nms_thr is missing"),
    ("[0.8, 0.6, 1.73]", "[0.8, 0, 1.73]", "sizes is .0.8, 0.0, 1.73., not a length, a width and a height above 0"),
    ("'KittiDataset'", "'MyDataset'", "above the ground is not known|intensities"),
]


@pytest.mark.parametrize(("there", "instead", "says"), MM)
def test_what_mmdetection3d_has_beyond(there: str, instead: str, says: str, tmp_path: Path) -> None:
    path = mm_pointpillars(tmp_path)
    text = path.read_text()
    assert there in text
    path.write_text(text.replace(there, instead))
    with pytest.raises(InputError, match=says):
        layout("mmdet3d", path)


def test_a_python_config_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = mm_pointpillars(tmp_path)
    expected = layout("mmdet3d", path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert layout("mmdet3d", path) == expected


def test_a_value_that_is_no_literal_is_named_with_its_line_where_it_is_needed(tmp_path: Path) -> None:
    path = mm_pointpillars(tmp_path)
    text = path.read_text() + "unused = open('/etc/hosts').read()\n"
    path.write_text(text)
    layout("mmdet3d", path)
    path.write_text(text.replace("feat_channels=[8]", "feat_channels=[int('8')]"))
    error = refused("mmdet3d", path)
    line = next(number for number, words in enumerate(path.read_text().splitlines(), 1) if "int('8')" in words)
    assert error.where == f"{path}, line {line}" and "int('8')" in str(error)


@pytest.mark.parametrize(
    "statement",
    [
        "model.update(type='x')",
        "model['type'] = 'x'",
        "for k in model: pass",
        "from x import y",
        "del model",
        "a = b = 1",
    ],
)
def test_a_statement_that_may_change_values_is_refused_with_its_line(statement: str, tmp_path: Path) -> None:
    path = mm_pointpillars(tmp_path)
    count = path.read_text().count("\n")
    path.write_text(path.read_text() + statement + "\n")
    assert refused("mmdet3d", path).where == f"{path}, line {count + 1}"


def test_nothing_of_a_config_runs(tmp_path: Path) -> None:
    path = tmp_path / "config.py"
    mark = tmp_path / "ran"
    path.write_text(f"import os\nx = open({str(mark)!r}, 'w')\nmodel = dict(a=__import__('os').mkdir({str(mark)!r}))\n")
    read_python_config(path)
    assert not mark.exists()


def test_values_of_python_configs(tmp_path: Path) -> None:
    (tmp_path / "base.py").write_text("a = 3\nt = dict(x=1, y=dict(z=2))\nu = dict(k=1)\nlist_ = [1, 2]\n")
    path = tmp_path / "top.py"
    path.write_text(
        '"""A text."""\n_base_ = "./base.py"\nr = [0, -1.5, 2]\ns = r[:2] + [_base_.a * 2]\nq = {"p": (r[0], -r[1])}\n'
        "t = dict(y=dict(w=s[-1]))\nu = dict(_delete_=True, m=sum([1, 2]))\nlist_ = [5]\nbig = 'x' * 10**9\n"
    )
    found = read_python_config(path)
    assert (found["a"], found["s"], found["q"]) == (3, [0, -1.5, 6], {"p": (0, 1.5)})
    assert found["t"] == {"x": 1, "y": {"z": 2, "w": 6}} and found["u"] == {"m": 3} and found["list_"] == [5]
    assert not isinstance(found["big"], str)


@pytest.mark.parametrize(("first", "then"), [("[0] * 1000", "x + x"), ("9", "x * x"), ("'ab'", "x * 9000")])
def test_arithmetic_that_would_fill_the_memory_is_not_done(first: str, then: str, tmp_path: Path) -> None:
    path = tmp_path / "top.py"
    path.write_text(f"x = {first}\n" + f"x = {then}\n" * 40)
    assert isinstance(read_python_config(path)["x"], UnevaluatedExpression)


def test_broken_python_configs(tmp_path: Path) -> None:
    path = tmp_path / "top.py"
    for text, says in (
        ("model = (\n", "line 1"),
        ("_base_ = './absent.py'\n", "absent.py"),
        ("_base_ = './top.py'\n", "leads back"),
        ("_base_ = 'a\\0b.py'\n", "no list of files"),
        ("model = 3\n", "model is 3"),
        ("x = 1\n", "model is missing"),
        ("_base_ = 3\n", "list of files"),
    ):
        path.write_text(text)
        assert says in str(refused("mmdet3d", path))


def test_what_a_data_set_implies_and_a_user_says(tmp_path: Path) -> None:
    path = mm_pointpillars(tmp_path)
    kitti = layout("mmdet3d", path)
    assert kitti["frame"] == {"height_m": 1.73, "turned": False} and kitti["head"]["vehicle"] == 2
    read = layout("mmdet3d", path, vehicle_class="Cyclist", sensor_height_m=1.9, intensity=0.5)
    assert read["frame"]["height_m"] == 1.9 and read["inputs"]["constants"] == [0.5] and read["head"]["vehicle"] == 1
    assert "Pedestrian, Cyclist, Car" in str(refused("mmdet3d", path, vehicle_class="Truck"))
    nuscenes = layout("mmdet3d", mm_centerpoint(tmp_path / "nuscenes"))
    assert nuscenes["frame"] == {"height_m": 1.84, "turned": True} and nuscenes["head"]["task"] == 1
    waymo = CASES["openpcdet-centerpoint"].write(tmp_path / "waymo")
    assert "intensities of WaymoDataset" in str(refused("openpcdet", waymo))


def test_a_file_that_is_none(tmp_path: Path) -> None:
    for name in ("openpcdet", "mmdet3d"):
        assert "no such file" in str(refused(name, tmp_path / "absent"))
    (tmp_path / "list.yaml").write_text("- 1\n")
    assert "no table" in str(refused("openpcdet", tmp_path / "list.yaml"))
