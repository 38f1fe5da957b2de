"""A map's ground: heights and drivable areas of an Argoverse 2 log match the frame of its scenes."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from analytic_fields import Frame, box, ground_scan, in_frame
from argoverse2_log import LOG, PERIOD, START, UP, write_log
from argoverse2_log import city_SE3_ego as written_pose

from shift3d.errors import InputError
from shift3d.geometry.boxes import corners_bev
from shift3d.geometry.rigid import inverse, moved
from shift3d.placement.constraints import Constraints
from shift3d.placement.ground import ground_under
from shift3d.placement.sampling import Placement, PlacementContext, PlacementLimits, place
from shift3d.placement.survey import survey
from shift3d.render import Beams
from shift3d.scenes.argoverse2.log import city_SE3_ego, lidar_mounts
from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes
from shift3d.scenes.ground_map import GroundMap
from shift3d.store.resolve import as_location

NAME = f"{LOG}-{START + PERIOD}"
CELL_M = 0.3
CORNER = (5060.0, 2300.0)  # city frame, of the raster's first cell


def hill(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the ground in the city."""
    return 66.5 + 0.04 * (x - 5172.0) - 0.03 * (y - 2419.0)


def write_map(log: Path) -> None:
    """Write a raster of the hill and a road 14 m wide along the city's x axis, in the data set's schema."""
    (log / "map").mkdir()
    column, row = np.meshgrid(np.arange(800), np.arange(800))
    x, y = CORNER[0] + (column + 0.5) * CELL_M, CORNER[1] + (row + 0.5) * CELL_M
    heights = np.where(x > 5100.0, hill(x, y), np.nan).astype(np.float16)
    np.save(log / "map" / f"{LOG}_ground_height_surface____PIT.npy", heights)
    similar = {"R": [1.0, 0.0, 0.0, 1.0], "t": [-CORNER[0], -CORNER[1]], "s": 1 / CELL_M}
    (log / "map" / f"{LOG}___img_Sim2_city.json").write_text(json.dumps(similar))
    road = [(5000.0, 2412.0), (5400.0, 2412.0), (5400.0, 2426.0), (5000.0, 2426.0)]
    area = {"id": 1, "area_boundary": [{"x": x, "y": y, "z": float(hill(np.array(x), np.array(y)))} for x, y in road]}
    whole = {"drivable_areas": {"1": area}, "lane_segments": {}, "pedestrian_crossings": {}}
    (log / "map" / f"log_map_archive_{LOG}____PIT_city_1.json").write_text(json.dumps(whole))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    folder = write_log(tmp_path)
    write_map(folder)
    return folder


def in_city(x: float, y: float) -> np.ndarray:
    """Return a place of the scene, level with its origin, in the city."""
    return (written_pose(START + PERIOD) @ [*(np.array([x, y, 0.0]) + UP), 1.0])[:3]


def test_heights_and_roads_lie_where_the_city_has_them(log: Path) -> None:
    scene = Argoverse2Scenes(log).load(NAME)
    found = scene.ground_map
    assert found is not None
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(-45.0, 45.0, (200, 2)):
        city = in_city(x, y)
        height = found.height_at(x, y)
        assert height is not None
        # A cell of 0.5 m on this slope, and half a step of float16 beyond 64 m.
        assert height == pytest.approx(float(hill(city[0], city[1])) - city[2], abs=0.05)
        off = abs(city[1] - 2419.0) - 7.0
        assert abs(off) < 0.5 or found.allows(x, y) == (off < 0.0)
    assert found.height_at(200.0, 0.0) is None and not found.allows(200.0, 0.0)


def test_a_log_without_a_map_has_none_and_one_with_it_is_another_scene(tmp_path: Path, log: Path) -> None:
    plain = Argoverse2Scenes(write_log(tmp_path / "plain")).load(NAME)
    mapped = Argoverse2Scenes(log)
    assert plain.ground_map is None and plain.content_hash() != mapped.load(NAME).content_hash()
    before = mapped.source(NAME)
    (log / "map" / f"{LOG}_ground_height_surface____PIT.npy").unlink()
    assert mapped.source(NAME) != before
    outlines = mapped.load(NAME).ground_map
    assert outlines is not None and np.isnan(outlines.height_m).all() and outlines.drivable is not None


@pytest.mark.parametrize("similar", [{"t": [1e300, 0.0], "s": 1.0}, {"t": [0.0, 0.0], "s": 1e300}])
def test_a_raster_out_of_reach_tells_no_height(log: Path, similar: dict[str, object]) -> None:
    (log / "map" / f"{LOG}___img_Sim2_city.json").write_text(json.dumps({"R": [1.0, 0.0, 0.0, 1.0], **similar}))
    found = Argoverse2Scenes(log).load(NAME).ground_map
    assert found is not None and np.isnan(found.height_m).all()


def outline(x: str) -> bytes:
    return f'{{"drivable_areas": {{"1": {{"area_boundary": [{{"x": {x}, "y": 0, "z": 0}}]}}}}}}'.encode()


def array_of_text() -> bytes:
    content = io.BytesIO()
    np.save(content, np.full((800, 800), "1.5"))
    return content.getvalue()


@pytest.mark.parametrize(
    ("part", "content", "says"),
    [
        (f"{LOG}_ground_height_surface____PIT.npy", b"", r"not a readable \.npy"),
        (f"{LOG}_ground_height_surface____PIT.npy", b"\x93NUMPY\x01\x00", r"not a readable \.npy"),
        (f"{LOG}_ground_height_surface____PIT.npy", array_of_text(), "<U3, not an array of numbers"),
        (f"{LOG}___img_Sim2_city.json", b"{}", "no R of 4 numbers"),
        (f"{LOG}___img_Sim2_city.json", b'{"R": [1, 0, 0, 1], "t": [0, NaN], "s": 3}', "no R of 4 numbers"),
        (f"{LOG}___img_Sim2_city.json", b'{"R": [1, 0, 0, 1], "t": [0, null], "s": 3}', "no R of 4 numbers"),
        (f"{LOG}___img_Sim2_city.json", b'{"R": ["a", 0, 0, 1], "t": [0, 0], "s": 3}', "no R of 4 numbers"),
        (f"{LOG}___img_Sim2_city.json", b'{"R": [1, 0, 0, 1], "t": [0, 0], "s": Infinity}', "no R of 4 numbers"),
        (f"{LOG}___img_Sim2_city.json", b"{", "not a readable JSON file"),
        (f"log_map_archive_{LOG}____PIT_city_1.json", b"[]", "no JSON object"),
        (f"log_map_archive_{LOG}____PIT_city_1.json", b'{"drivable_areas": {"1": {}}}', "no drivable_areas of"),
        (f"log_map_archive_{LOG}____PIT_city_1.json", outline('"a"'), "no drivable_areas of"),
        (f"log_map_archive_{LOG}____PIT_city_1.json", outline("null"), "an outline without finite points"),
    ],
)
def test_damaged_maps_give_one_clear_line(log: Path, part: str, content: bytes, says: str) -> None:
    (log / "map" / part).write_bytes(content)
    with pytest.raises(InputError, match=f"{part.replace('.', '[.]')}.*{says}") as caught:
        Argoverse2Scenes(log).load(NAME)
    assert "\n" not in str(caught.value) and caught.value.remedy


def test_places_keep_to_the_road_and_start_from_the_maps_height() -> None:
    beams = Beams.from_arrays(*ground_scan(rings=64, columns=900))
    limits, rules = PlacementLimits(9.0, 12.0, attempts=60), Constraints(min_object_points=100)
    road = np.array([[-50.0, -8.0], [50.0, -8.0], [50.0, 8.0], [-50.0, 8.0]])
    known = GroundMap.of(np.zeros((0, 3)), [road])
    found = survey(PlacementContext(beams, -1.73, ground_map=known), limits, rules)
    assert set(found.outcomes) == {"free", "off_road"}
    assert (np.abs(found.xy_m[found.free, 1]) < 7.5).all()
    assert (np.abs(found.xy_m[~found.free, 1]) > 5.0).all()
    # The nominal height alone finds no ground here; the map does.
    xy = np.stack(np.meshgrid(np.arange(-40.0, 40.0, 0.3), np.arange(-40.0, 40.0, 0.3)), axis=-1).reshape(-1, 2)
    ground = np.column_stack((xy, np.full(len(xy), -1.73)))
    wrong = survey(PlacementContext(beams, 9.0), limits, rules)
    right = survey(PlacementContext(beams, 9.0, ground_map=GroundMap.of(ground, None)), limits, rules)
    assert not wrong.free.any() and right.free.all()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_vehicle_is_put_on_the_road(seed: int) -> None:
    frame, rules = Frame((4.0, 1.8, 1.4)), Constraints(min_object_points=100)
    road = GroundMap.of(np.zeros((0, 3)), [np.array([[-50.0, 5.0], [50.0, 5.0], [50.0, 13.0], [-50.0, 13.0]])])
    beams, crate = Beams.from_arrays(*ground_scan(rings=64, columns=900)), in_frame(box((2.0, 0.9, 0.7)), frame)
    rng, limits = np.random.default_rng(seed), PlacementLimits(9.0, 12.0, attempts=80)
    placed = place(PlacementContext(beams, -1.73, ground_map=road), crate, frame, rng, limits, rules)
    assert isinstance(placed, Placement) and placed.check.valid
    footprint = corners_bev(np.array([[*placed.theta[:3].tolist(), 4.0, 1.8, 1.4, float(placed.theta[3])]]))[0]
    assert ((footprint[:, 1] > 4.5) & (footprint[:, 1] < 13.5)).all()
    assert placed.rejected.get("off_road", 0) == placed.attempts - 1


def test_the_map_of_the_real_log_is_level_with_its_returns(real_data: Callable[[str], Path]) -> None:
    """Points of lane boundaries 43 and 55 m behind, from the map in the city frame, are on the fitted ground."""
    root = real_data("argoverse2") / "val"
    scene = Argoverse2Scenes(root).load(Argoverse2Scenes(root).names()[0])
    name, _, timestamp = scene.scene_id.rpartition("-")
    log = as_location(root / name)
    city_SE3_scene = city_SE3_ego(log, int(timestamp))[0]
    city_SE3_scene[:3, 3] += city_SE3_scene[:3, :3] @ lidar_mounts(log)[0]
    lanes = np.array([(5180.46, 2416.73, 66.82), (5193.6, 2415.04, 67.19)])
    for x, y, z in moved(lanes, inverse(city_SE3_scene)):
        plane = ground_under(scene.points.astype(np.float64), (x, y), scene.ground_z_m, 2.9)
        assert plane is not None
        print(f"map less returns at ({x:.1f}, {y:.1f}): {100 * (z - plane.height_m):+.1f} cm")
        assert plane.height_m == pytest.approx(z, abs=0.2)
