"""The Scene record refuses unrenderable data, and its hash is the same for equal scenes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.scenes.scene import Conditions, Labels, Scene
from shift3d.scenes.sensor import SensorModel


def make_scene(**changes: Any) -> Scene:
    points = np.array([[5.0, 0.0, -1.5], [6.0, 1.0, -1.5], [7.0, -1.0, -1.4]], dtype=np.float32)
    values: dict[str, Any] = {
        "scene_id": "made-up",
        "dataset": "test",
        "points": points,
        "origins": np.broadcast_to(np.zeros((1, 3), np.float32), points.shape),
        "ground_z_m": -1.73,
        "labels": Labels(
            boxes=np.array([[6.0, 0.0, -1.0, 4.0, 2.0, 1.5, 0.3]]),
            classes=("vehicle",),
            num_points=np.array([3], dtype=np.int32),
        ),
        "reflectance": np.array([0.1, 0.5, 1.0], dtype=np.float32),
        "range_image_index": np.array([[0, 1], [1, 1], [2, 5]], dtype=np.int32),
    }
    return Scene(**{**values, **changes})


def test_a_good_scene_passes() -> None:
    make_scene().validate()
    make_scene(labels=Labels(), reflectance=None, range_image_index=None).validate()


def bad_points(row: int, value: float) -> np.ndarray:
    points = make_scene().points.copy()
    points[row, 1] = value
    return points


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"points": bad_points(1, np.nan)}, r"points.*row 1"),
        ({"points": bad_points(2, np.inf)}, r"points.*row 2"),
        ({"points": np.zeros((3, 4), np.float32)}, r"points.*\(3, 4\)"),
        ({"points": make_scene().points.astype(np.float64)}, r"points.*float64"),
        ({"origins": np.zeros((2, 3), np.float32)}, r"origins.*\(2, 3\)"),
        ({"origins": np.float32([[0, 0, 0], [0, 2e4, 0], [0, 0, 0]])}, r"origins: the beam of row 1 starts.*pose"),
        ({"points": np.zeros((3, 3), np.float32)}, r"points.*positive range"),
        ({"points": np.zeros((0, 3), np.float32)}, r"points.*no points"),
        ({"reflectance": np.array([0.1, 2.0, 0.1], np.float32)}, r"reflectance.*row 1"),
        ({"reflectance": np.zeros(2, np.float32)}, r"reflectance.*\(2,\)"),
        ({"range_image_index": np.zeros((3, 2), np.int64)}, r"range_image_index.*int64"),
        ({"time_s": np.array([0.0, np.nan, 0.0], np.float32)}, r"time_s.*row 1"),
        ({"ground_z_m": float("nan")}, r"ground_z_m"),
        ({"scene_id": ""}, r"scene_id"),
        ({"conditions": Conditions(weather="sleet")}, r"conditions.weather.*sleet"),
        ({"conditions": Conditions(weather="rain", rain_mm_h=-1.0)}, r"rain_mm_h"),
        ({"conditions": Conditions(weather="fog", visibility_m=0.0)}, r"visibility_m"),
        *(
            ({"conditions": Conditions(ego_velocity_m_s=(0.0, speed, 0.0))}, r"ego_velocity_m_s.*poses")
            for speed in (np.nan, np.inf, -2e3)
        ),
    ],
)
def test_a_bad_scene_is_refused_with_field_and_row(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        make_scene(**changes).validate()
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"boxes": np.array([[6.0, 0, 0, 4.0, 0.0, 1.5, 0]])}, r"dy = 0"),
        ({"boxes": np.array([[6.0, 0, 0, 4.0, 2.0, -1.5, 0]])}, r"dz = -1.5"),
        ({"boxes": np.array([[6.0, np.nan, 0, 4.0, 2.0, 1.5, 0]])}, r"y = nan"),
        ({"classes": ()}, r"labels.classes.*0 classes for 1"),
        ({"names": ("Car", "Van")}, r"labels.names"),
        ({"num_points": np.zeros(2, np.int32)}, r"labels.num_points"),
        ({"num_points": np.array([-1], np.int32)}, r"labels.num_points.*row 0"),
    ],
)
def test_bad_labels_are_refused(changes: dict[str, Any], says: str) -> None:
    labels = dataclasses.replace(make_scene().labels, **changes)
    with pytest.raises(InputError, match=says) as caught:
        make_scene(labels=labels).validate()
    assert "made-up" in str(caught.value)


def test_points_at_their_origin_carry_no_beam() -> None:
    points = make_scene().points.copy()
    points[1] = 0.0
    scene = make_scene(points=points)
    scene.validate()
    assert scene.has_beam.tolist() == [True, False, True]


def test_hash_is_of_the_content() -> None:
    scene = make_scene()
    copied = make_scene(origins=np.zeros((3, 3), np.float32))  # broadcast view or copy: the same content
    assert scene.content_hash() == copied.content_hash()
    assert len(scene.content_hash()) == 32


@pytest.mark.parametrize(
    "changes",
    [
        {"points": bad_points(1, 1.0001)},
        {"ground_z_m": -1.74},
        {"scene_id": "other"},
        {"reflectance": None},
        {"labels": Labels()},
        {"conditions": Conditions(weather="rain", rain_mm_h=5.0)},
        {"range_image_index": np.array([[0, 1], [1, 1], [2, 6]], dtype=np.int32)},
    ],
)
def test_hash_changes_with_every_field(changes: dict[str, Any]) -> None:
    assert make_scene().content_hash() != make_scene(**changes).content_hash()


@dataclasses.dataclass(frozen=True)
class WithHail(Conditions):
    hail_mm_h: float = 0.0


@dataclasses.dataclass(frozen=True)
class WithWavelength(SensorModel):
    wavelength_nm: float = 905.0


def test_a_new_field_changes_no_hash_of_scenes_that_do_not_state_it() -> None:
    """The seed of a placement depends on the scene's hash: a new weather must not move the vehicles of dry scenes."""
    for name, old, new, stated in (
        ("conditions", Conditions(), WithHail(), WithHail(hail_mm_h=2.0)),
        ("sensor", SensorModel(), WithWavelength(), WithWavelength(wavelength_nm=1550.0)),
    ):
        known, same, other = (make_scene(**{name: value}).content_hash() for value in (old, new, stated))
        assert known == same != other
