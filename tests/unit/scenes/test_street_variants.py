"""Street scenes with options: their additions; everything else stays the same, byte for byte."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shift3d.geometry.boxes import points_in_boxes
from shift3d.scenes.facts import SceneFacts
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.street.assemble import street_scene
from shift3d.scenes.street.options import StreetOptions
from shift3d.scenes.street.second_hits import SEPARATION_M
from shift3d.scenes.street.sensors import SENSORS, SHORT32

RECORDED = Path(__file__).parent / "streets_without_options.json"
"""Two scenes without options, as numbers that do not depend on a processor's last bits.

`python tests/unit/scenes/test_street_variants.py` rewrites the file after an intended change of scenes.
"""
PLAIN = {"hdl64": ("test", 0, 3, "hdl64"), "waymo_top": ("test", 0, 4, "waymo_top")}
PER_POINT = ("points", "origins", "reflectance", "time_s", "range_image_index")


@functools.cache
def scene(sensor: str = "hdl64", index: int = 3, **options: Any) -> Scene:
    made = street_scene("test", 0, index, sensor, StreetOptions(**options))
    made.validate()
    return made


def in_numbers(made: Scene) -> dict[str, Any]:
    """Return number, quantiles (per axis, metres) and brightness of points; the boxes and their number of points."""
    quantiles = np.linspace(0.02, 0.98, 25)
    return {
        "scene": [made.scene_id, made.dataset, made.ground_z_m, list(made.labels.classes)],
        "points": len(made.points),
        "quantiles_m": np.quantile(made.points.astype(np.float64), quantiles, axis=0).round(4).tolist(),
        "reflectance": np.bincount((made.reflectance * 10).round().astype(int), minlength=11).tolist(),
        "boxes": made.labels.boxes.round(9).tolist(),
        "num_points": made.labels.num_points.tolist(),
    }


def rows(made: Scene, which: slice, names: tuple[str, ...] = PER_POINT) -> list[bytes]:
    return [np.ascontiguousarray(getattr(made, name)[which]).tobytes() for name in names]


@pytest.mark.parametrize("sensor", list(PLAIN))
def test_without_options_scenes_are_what_they_were(sensor: str) -> None:
    made = street_scene(*PLAIN[sensor])
    found, recorded = in_numbers(made), json.loads(RECORDED.read_text())[sensor]
    assert found["scene"] == recorded["scene"]
    np.testing.assert_allclose(found["boxes"], recorded["boxes"], rtol=0.0, atol=1e-6)
    # A beam in ten thousand may meet the other side of an edge, or be rounded to the next millimetre.
    assert abs(found["points"] - recorded["points"]) <= 1e-4 * recorded["points"]
    np.testing.assert_allclose(found["quantiles_m"], recorded["quantiles_m"], rtol=0.0, atol=0.02)
    np.testing.assert_allclose(found["num_points"], recorded["num_points"], rtol=0.0, atol=3)
    np.testing.assert_allclose(found["reflectance"], recorded["reflectance"], rtol=0.01, atol=20)
    assert (made.return_number, made.sensor, made.no_return, made.conditions) == (None, None, None, Conditions())
    assert made.origins.strides[0] == 0


@pytest.mark.parametrize(
    "options",
    [
        {"weather": "fog", "visibility_m": 50.0},
        {"weather": "rain"},
        {"weather": "snow"},
        {"sensor_model": True},
        {"range_image": True},
    ],
)
def test_statements_leave_points_and_labels_alone(options: dict[str, Any]) -> None:
    plain, stating = scene(), scene(**options)
    assert rows(stating, slice(None)) == rows(plain, slice(None))
    assert stating.labels.boxes.tobytes() == plain.labels.boxes.tobytes()
    assert stating.content_hash() != plain.content_hash()


def test_weather_is_stated_as_not_yet_in_the_points() -> None:
    for weather, field, value in (
        ("fog", "visibility_m", 50.0),
        ("rain", "rain_mm_h", 4.0),
        ("snow", "snow_mm_h", 2.0),
    ):
        stated = scene(weather=weather, **{field: value}).conditions
        assert (stated.weather, stated.weather_in_points, getattr(stated, field)) == (weather, False, value)
        calm = {"visibility_m": float("inf"), "rain_mm_h": 0.0, "snow_mm_h": 0.0}
        assert all(getattr(stated, name) == quiet for name, quiet in calm.items() if name != field)


def nearest(values: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return (N,) index of the table's entry nearest to each value."""
    order = np.argsort(table)
    above = np.searchsorted(table[order], values).clip(1, len(table) - 1)
    is_lower = values - table[order][above - 1] < table[order][above] - values
    return order[above - is_lower]


@pytest.mark.parametrize("sensor", SENSORS)
def test_every_beam_is_a_point_or_without_a_return(sensor: str) -> None:
    made = scene(sensor, range_image=True)
    table, no_returns, pixel = SENSORS[sensor], made.no_return, made.range_image_index
    assert no_returns is not None and pixel is not None and no_returns.time_s is not None
    count = len(table.elevations_rad) * table.columns
    assert len(no_returns) + len(made.points) == count
    row = nearest(np.arcsin(no_returns.directions[:, 2]), np.array(table.elevations_rad))
    column = nearest(np.arctan2(no_returns.directions[:, 1], no_returns.directions[:, 0]), table.azimuths_rad())
    cells = np.concatenate((row * table.columns + column, pixel[:, 0] * table.columns + pixel[:, 1]))
    np.testing.assert_array_equal(np.sort(cells), np.arange(count))
    np.testing.assert_allclose(no_returns.time_s, column * (table.turn_s / table.columns), atol=1e-7)
    assert not no_returns.origins.any()


@pytest.mark.parametrize("sensor", SENSORS)
def test_second_returns_follow_the_first_ones_and_share_their_beams(sensor: str) -> None:
    plain, made = scene(sensor), scene(sensor, returns=2)
    number, count = made.return_number, len(plain.points)
    assert number is not None and number.dtype == np.uint8 and made.range_image_index is not None
    assert rows(made, slice(count)) == rows(plain, slice(None))
    assert not number[:count].any() and (number[count:] == 1).all()
    assert 100 < len(made.points) - count < 0.2 * count
    first = {tuple(pixel): row for row, pixel in enumerate(made.range_image_index[:count].tolist())}
    pixels = [tuple(pixel) for pixel in made.range_image_index[count:].tolist()]
    assert len(set(pixels)) == len(pixels) and pixels == sorted(pixels)
    before = np.array([first[pixel] for pixel in pixels])
    assert made.time_s is not None and (made.time_s[count:] == made.time_s[before]).all()
    ranges = np.linalg.norm(made.points.astype(np.float64), axis=1)
    directions = made.points / ranges[:, None]
    np.testing.assert_allclose(directions[count:], directions[before], atol=1e-6)
    assert (ranges[count:] - ranges[before] >= SEPARATION_M - 1e-5).all()
    assert made.origins.strides[0] == 0
    assert SceneFacts.of(made).returns == 2


def test_side_sensors_are_appended_and_look_from_their_corners() -> None:
    plain, made = scene(), scene(sensors=3, range_image=True)
    count, main = len(plain.points), SENSORS["hdl64"]
    names = ("points", "origins", "reflectance", "time_s")
    assert rows(made, slice(count), names) == rows(plain, slice(None), names)
    assert made.range_image_index is None and made.no_return is not None
    height = SHORT32.mount_height_m - main.mount_height_m
    corners = np.unique(made.origins[count:], axis=0)
    np.testing.assert_allclose(corners, [[2.0, -1.0, height], [2.0, 1.0, height]], atol=1e-6)
    each = len(SHORT32.elevations_rad) * SHORT32.columns
    assert len(made.points) + len(made.no_return) == len(main.elevations_rad) * main.columns + 2 * each
    for y, outwards in ((1.0, np.pi / 4), (-1.0, -np.pi / 4)):
        for points, origins in (
            (made.points[count:], made.origins[count:]),
            (made.no_return.origins + made.no_return.directions, made.no_return.origins),
        ):
            own = origins[:, 1] == y
            offset = (points[own] - origins[own]).astype(np.float64)
            azimuth = np.arctan2(offset[:, 1], offset[:, 0]) - outwards
            azimuth = np.mod(azimuth + np.pi, 2 * np.pi) - np.pi
            assert np.abs(azimuth).max() < SHORT32.view_rad / 2
            elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
            off = np.abs(elevation[:, None] - np.array(SHORT32.elevations_rad)).min(axis=1)
            assert (off < 1e-5 + 1e-6 / np.linalg.norm(offset, axis=1)).all()
    ranges = np.linalg.norm(made.points[count:] - made.origins[count:], axis=1)
    assert SHORT32.min_range_m - 1e-3 < ranges.min() and 20.0 < ranges.max() <= SHORT32.max_range_m + 1e-3
    assert SceneFacts.of(made).origins == 2 and SceneFacts.of(plain).origins == 1


def test_points_of_a_moving_sensor_in_both_frames() -> None:
    """The returns are the same: at time 0 they are v t farther ahead than in the sensor's frame at its firing."""
    speed = 20.0
    raw, whole = scene(ego_speed_m_s=speed), scene(ego_speed_m_s=speed, motion_compensated=True)
    assert raw.time_s is not None and whole.time_s is not None
    np.testing.assert_array_equal(raw.time_s, whole.time_s)
    np.testing.assert_array_equal(raw.reflectance, whole.reflectance)
    driven = speed * raw.time_s.astype(np.float64)
    np.testing.assert_allclose(whole.points[:, 0] - raw.points[:, 0], driven, atol=2e-5)
    np.testing.assert_array_equal(whole.points[:, 1:], raw.points[:, 1:])
    np.testing.assert_allclose(whole.origins[:, 0], driven, atol=1e-6)
    assert not whole.origins[:, 1:].any() and not raw.origins.any()
    for made, compensated in ((raw, False), (whole, True)):
        assert made.conditions.ego_velocity_m_s == (speed, 0.0, 0.0)
        assert made.conditions.motion_compensated is compensated
        assert made.conditions.weather_in_points
    assert raw.labels.boxes.tobytes() == whole.labels.boxes.tobytes()
    inside = points_in_boxes(whole.points, whole.labels.boxes).sum(axis=1)
    np.testing.assert_array_equal(whole.labels.num_points, inside)
    # Float32 rounds a point on a side of a box to either side of it.
    np.testing.assert_allclose(raw.labels.num_points, inside, atol=3)


def test_options_do_not_change_each_others_draws() -> None:
    alone = scene(returns=2)
    every = scene(weather="fog", returns=2, range_image=True, sensor_model=True)
    assert rows(every, slice(None)) == rows(alone, slice(None))
    assert every.labels.num_points.tobytes() == alone.labels.num_points.tobytes()
    both, side = scene(sensors=3), scene(sensors=2)
    assert rows(both, slice(len(side.points)), ("points", "origins")) == rows(side, slice(None), ("points", "origins"))


def test_options_give_the_same_bytes_again() -> None:
    options = StreetOptions(sensors=2, range_image=True, ego_speed_m_s=10.0)
    again = [street_scene("val", 1, 2, "waymo_top", options).content_hash() for _ in range(2)]
    assert again[0] == again[1]


if __name__ == "__main__":
    RECORDED.write_text(json.dumps({name: in_numbers(street_scene(*given)) for name, given in PLAIN.items()}) + "\n")
