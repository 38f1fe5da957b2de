"""Streets under another sensor's beams: the tables of the sensors, and the same street under all of them."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from published_beams import HDL_32E, PANDAR64_CALIBRATED, PANDAR64_OFFSET, VLP_32C

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.scenes.street.options import BEAM_NAMES, StreetOptions
from shift3d.scenes.street.sensors import BEAMS, other_heads

PUBLISHED = {  # beams of a head, highest and lowest elevation in degrees, the finest step between two beams
    "hdl64": (64, 2.0, -24.33, 1 / 3),
    "waymo_top": (64, 2.4, -17.6, 0.145),
    "hdl32": (32, 10.67, -30.67, 4 / 3),
    "av2_pair": (32, 15.0, -25.0, 1 / 3),
    "pandar64": (64, 14.88, -24.9, 1 / 6),
}
SINGLE = [name for name in BEAM_NAMES if name != "av2_pair"]


@functools.cache
def scene(beams: str | None) -> Scene:
    streets = StreetScenes("waymo_top", count=1, options=StreetOptions(beams=beams))
    return streets.load(streets.names()[0])


@pytest.mark.parametrize("name", BEAM_NAMES)
def test_beams_are_those_of_the_published_table(name: str) -> None:
    assert name in PUBLISHED, "PUBLISHED: add the sensor's published elevations"
    count, top, bottom, step = PUBLISHED[name]
    degrees = np.rad2deg(BEAMS[name].elevations_rad)
    assert len(degrees) == count and (np.diff(degrees) < 0).all()
    np.testing.assert_allclose((degrees[0], degrees[-1]), (top, bottom), atol=0.02)
    assert -np.diff(degrees).max() == pytest.approx(step, abs=0.01)


@pytest.mark.parametrize(
    ("name", "published", "atol"),
    [
        ("hdl32", HDL_32E, 0.01),
        ("av2_pair", VLP_32C, 1e-6),
        ("pandar64", np.array(PANDAR64_CALIBRATED) + PANDAR64_OFFSET, 0.0015),
    ],
)
def test_every_beam_is_that_of_the_maker(name: str, published: np.ndarray, atol: float) -> None:
    np.testing.assert_allclose(np.rad2deg(BEAMS[name].elevations_rad), np.sort(published)[::-1], rtol=0, atol=atol)


def test_the_pair_is_a_head_and_the_same_upside_down_below_it() -> None:
    ((lower, mount),) = other_heads(BEAMS["av2_pair"], 0.0)
    np.testing.assert_allclose(np.sort(lower.elevations_rad), np.sort(-np.array(BEAMS["av2_pair"].elevations_rad)))
    np.testing.assert_allclose(mount.origin_m, (0.0, 0.0, -0.115))
    made = scene("av2_pair")
    assert sorted(set(map(tuple, made.origins.tolist()))) == [(0.0, 0.0, pytest.approx(-0.115)), (0.0, 0.0, 0.0)]
    assert made.range_image_index is None


@pytest.mark.parametrize("name", SINGLE)
def test_rows_go_down_and_columns_clockwise(name: str) -> None:
    made, sensor = scene(name), BEAMS[name]
    x, y, z = made.points.astype(np.float64).T
    row, column = made.range_image_index.T  # type: ignore[union-attr]
    np.testing.assert_allclose(np.arctan2(z, np.hypot(x, y)), np.array(sensor.elevations_rad)[row], atol=1e-5)
    turned = np.mod(np.arctan2(y, x) - sensor.azimuths_rad()[column] + np.pi, 2 * np.pi) - np.pi
    assert np.abs(turned).max() < 1e-5
    assert (np.diff(row) >= 0).all() and (np.diff(column)[np.diff(row) == 0] > 0).all()


@pytest.mark.parametrize("name", BEAM_NAMES)
def test_the_street_is_the_same(name: str) -> None:
    """Ground and vehicles stay; returns within a metre of the ground's height are those of the same ground."""
    own, other = scene(None), scene(name)
    assert other.ground_z_m == own.ground_z_m
    boxes = own.labels.of_class("vehicle")
    near = boxes[np.hypot(*boxes[:, :2].T) < 30.0]
    seen = other.labels.of_class("vehicle")
    apart = np.linalg.norm(near[:, None, :3] - seen[None, :, :3], axis=2).min(axis=1)
    assert (apart < 1e-9).mean() > 0.7  # a vehicle behind another may meet no beam of a sensor
    assert points_in_boxes(other.points, boxes).any()


def test_other_beams_are_another_scene_and_the_own_is_as_it_was() -> None:
    names = {beams: scene(beams).scene_id for beams in (None, *BEAM_NAMES)}
    assert names[None] == "street-test-waymo_top-000000"
    assert names["hdl32"] == "street-test-waymo_top-000000-beams_hdl32"
    assert len({scene(beams).content_hash() for beams in names}) == len(names)
    assert len(scene("hdl32").points) < 0.5 * len(scene("pandar64").points)


def test_unknown_beams_and_returns_of_two_heads_are_refused() -> None:
    with pytest.raises(InputError, match=r"unknown beams 'hdl128'\. Choose from hdl64"):
        StreetOptions(beams="hdl128")
    with pytest.raises(InputError, match=r"beams=av2_pair.*Set returns=1"):
        StreetOptions(beams="av2_pair", returns=2)


def test_the_list_of_names_is_that_of_the_sensors() -> None:
    assert tuple(BEAMS) == BEAM_NAMES, "scenes/street: sensors.toml and options.py name the same sensors in one order"
    assert StreetOptions(traffic="wide", beams="av2_pair").tag == "-wide-beams_av2_pair"
