"""Hard cases of effects: data of scenes and settings, single-beam returns, no-return beams, cones, far points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from catalogue import hard_case
from clear_errors import refused
from hard_echoes import AHEAD, BALL, READER, ahead, drawn, on_object, scene_of

from shift3d.detectors.grid import WAYMO_GRID, assign_pillars, full_window
from shift3d.effects.applicability import MeasuredImpact, choose, effect_named
from shift3d.effects.base import EffectContext
from shift3d.effects.chain import EffectChain
from shift3d.effects.divergence import strongest
from shift3d.render import Beams
from shift3d.scenes.facts import EffectSettings, SceneFacts
from shift3d.scenes.reflectance import full_reflectance
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import NoReturnBeams, SensorModel

AREA = "effects"


@hard_case(
    area=AREA,
    why="a scene is validated when it is read, and settings are laid over it afterwards",
    must="an error that names the setting: a cone of 7 rad, noise of 1e30 m, a limit whose square is infinite",
    guard="settings have the bounds of a sensor",
)
def settings_of_no_sensor() -> None:
    for name, value in (("divergence_rad", 7.0), ("range_noise_m", 1e30), ("limit_range_m", 1e200)):
        refused(lambda name=name, value=value: EffectSettings(**{name: value}), f"sensor.{name}")  # type: ignore[misc]


@hard_case(
    area=AREA,
    why="every comparison with NaN is false, so that it is not out of any bounds",
    must="an error that names the field",
    guard="a value must lie within its bounds, not fail to lie outside",
)
def a_sensor_whose_divergence_is_not_a_number() -> None:
    refused(lambda: scene_of([[20.0, 0.0, 0.0]], sensor=SensorModel(divergence_rad=math.nan)), "divergence_rad")


@hard_case(
    area=AREA,
    why="fog would be laid over points that were seen through fog",
    must="an error that names the setting to leave out; settings of the sensor are taken",
    guard="points carry one weather",
)
def weather_on_a_scene_that_carries_weather_already() -> None:
    scene = scene_of([[20.0, 0.0, 0.0]], conditions=Conditions("rain", rain_mm_h=5.0))
    refused(lambda: drawn(scene, ["fog"], visibility_m=50.0), "carry rain already", "visibility_m")
    drawn(scene, ["ray_drop"], limit_range_m=80.0)


@hard_case(
    area=AREA,
    why="no beam starts in the scene's origin, and yet there is one sensor",
    must="beams start where they started, and the effect of several sensors is not called for",
    guard="places are compared with each other, not with the scene's origin",
)
def beams_that_all_start_in_one_place_that_is_not_the_origin() -> None:
    origins = np.broadcast_to(np.array([[1.5, -0.7, 0.2]], np.float32), (6, 3))
    scene = scene_of([[30.0, 0.1 * i, 0.0] for i in range(6)], origins=origins)
    assert choose("auto", SceneFacts.of(scene), READER) == []
    chain = EffectChain.of([], scene, BALL, 1, EffectSettings())
    assert torch.equal(chain.beams.origins, Beams.from_scene(scene).origins)


@hard_case(
    area=AREA,
    why="times count from somewhere: all beams of a flash fire at once, and not at 0",
    must="nothing rolls: the effect is not called for, however fast the object",
    guard="a scan lasts from its first firing time to its last",
)
def firing_times_that_are_all_the_same() -> None:
    scene = ahead(30.0, 6, time_s=np.array([0.08], np.float32))
    facts = SceneFacts.of(scene, EffectSettings(object_speed_m_s=40.0))
    assert facts.scan_s == 0.0 and choose("auto", facts, READER) == []


@hard_case(
    area=AREA,
    why="a measurement that went wrong says neither that an effect matters nor that it does not",
    must="the effect is kept",
    guard="an effect is left out where it was measured to lie below the bound, not where it does not exceed it",
)
def an_impact_that_is_not_a_number() -> None:
    assert (
        MeasuredImpact(math.nan, math.nan, math.nan, 1.0).matters and not MeasuredImpact(0.001, 0.0, 0.002, 1.0).matters
    )


def stopped(scene: Scene) -> list[bool]:
    """Return which rows of a scene return when the object is in front of all of them."""
    _, returns = on_object(scene, Conditions(), None)
    step: Any = effect_named("second_returns").bind(EffectContext(scene, Beams.from_scene(scene), BALL, 3))
    found: list[bool] = step(returns).returned.tolist()
    return found


def returns_of_pixels(pixels: list[tuple[int, int]], numbers: list[int], **parts: Any) -> Scene:
    index, number = np.array(pixels, np.int32), np.array(numbers, np.uint8)
    return scene_of(
        [[20.0, i, 0.0] for i in range(len(pixels))], range_image_index=index, return_number=number, **parts
    )


@hard_case(
    area=AREA,
    why="range gates and crops drop first returns",
    must="a second return whose first is not in the scene is the object's echo, and comes back",
    guard="a return is compared with the earliest of its beam that is there",
)
def a_second_return_without_a_first() -> None:
    assert stopped(returns_of_pixels([(0, 0), (0, 0), (5, 9)], [0, 1, 1])) == [True, False, True]


@hard_case(
    area=AREA,
    why="points that are in no range image all have the pixel (-1, -1)",
    must="each is a beam of its own, and comes back",
    guard="only pixels of at least 0 are paired",
)
def points_without_a_pixel() -> None:
    assert all(stopped(returns_of_pixels([(-1, -1)] * 3, [0, 1, 1])))


@hard_case(
    area=AREA,
    why="two sensors count their pixels alike",
    must="a second return of one is not stopped by the first of the other",
    guard="rows of one beam share their origin too",
)
def one_pixel_of_two_sensors() -> None:
    origins = np.array([[0, 0, 0], [0, 0.5, 0]], np.float32)
    assert all(stopped(returns_of_pixels([(3, 7), (3, 7)], [0, 1], origins=origins)))


def with_no_return(directions: np.ndarray, **parts: Any) -> Scene:
    """Return a scene of one point 40 m ahead and beams from the origin without a return."""
    unit = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    return scene_of([[40.0, 0.0, 0.0]], no_return=NoReturnBeams(np.zeros_like(unit), unit), **parts)


@hard_case(
    area=AREA,
    why="they have a row, as every beam that is cast, and a row has a point",
    must="no point of theirs lies in a pillar of any detector, and none is counted as a return",
    guard="beams without a return rest 10 km out",
)
def no_return_beams_that_meet_nothing() -> None:
    rendering = drawn(
        with_no_return(np.random.default_rng(1).standard_normal((50, 3)) * [1, 1, 0.05]), ["no_return_beams"]
    )
    assert rendering.returned is not None and rendering.returned.tolist() == [True] + [False] * 50
    pillars = assign_pillars(rendering.points, WAYMO_GRID, full_window(WAYMO_GRID))
    assert pillars.order.tolist() == [0]


@hard_case(
    area=AREA,
    why="fog outshines whatever lies 10 km away, and there lie the rows of no-return beams",
    must="they stay without a return: fog in front of the sky is left out",
    guard="no-return beams bring nothing back before the weather acts",
)
def no_return_beams_in_fog() -> None:
    scene = with_no_return(np.random.default_rng(2).standard_normal((20, 3)))
    rendering = drawn(scene, ["no_return_beams", "fog"], visibility_m=30.0)
    assert rendering.returned is not None and not rendering.returned[1:].any()
    assert (rendering.range_m[1:] > 9e3).all()


@hard_case(
    area=AREA,
    why="all seven echoes have no power, and half of nothing is no less than nothing",
    must="the beam stays without a return: the object has to send something back",
    guard="what wins has power",
)
def a_cone_past_the_object_with_nothing_behind() -> None:
    edge = 1.0 / math.sqrt(399.0)
    aim = np.array([[1.0, (1.0 + gap) * edge, 0.0] for gap in (0.021, 0.022, 0.023, 0.024, 0.03)])
    rendering = drawn(with_no_return(aim), ["no_return_beams", "divergence"], AHEAD, divergence_rad=3e-3)
    assert rendering.returned is not None and not rendering.returned[1:].any()


@hard_case(
    area=AREA,
    why="its beams meet the surface at range 0, where an echo has infinite power, and infinite shares of it are NaN",
    must="beams that graze the surface it stands on are on the object, within a centimetre, and nothing is NaN",
    guard="power grows no further where the receiver sees nothing",
)
def a_sensor_on_the_surface_of_the_object() -> None:
    inwards = np.linspace(2e-4, 2.5e-3, 40)
    scene = scene_of(30.0 * np.stack((inwards, np.ones(40), np.zeros(40)), axis=1))
    for gap in (0.0, 1e-12, 1e-9, 1e-8):
        theta = torch.tensor([1.0 + gap, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        rendering = drawn(scene, ["divergence"], theta, divergence_rad=3e-3)
        assert (rendering.first_hits.range_m == 0.0).sum() > 30, "what makes it hard"
        assert rendering.hit_mask.all() and (rendering.range_m.abs() < 0.01).all()


@hard_case(
    area=AREA,
    why="their echoes overlap, and the nearer alone is weaker than what lies far behind",
    must="they merge into one echo, which wins together",
    guard="echoes nearer to each other than a pulse add up",
)
def two_surfaces_within_one_pulse() -> None:
    range_m = torch.tensor([[20.0, 20.5, 60.0]], dtype=torch.float64)
    light = torch.tensor([[2.0, 2.0, 3.0]], dtype=torch.float64)
    assert strongest(range_m, light).tolist() == [[True, True, False]]


@hard_case(
    area=AREA,
    why="float32 has a millimetre there, which a hit at an angle would lie off its beam",
    must="noise moves points along the beam alone: rounded once, not twice",
    guard="effects start from hits on their beams, in float64",
)
def an_object_10_km_away_in_float32() -> None:
    place = np.array([7011.3, 7101.9, 803.7])
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9))
    aims = place + np.stack((-0.7 * y, 0.7 * y, z), -1).reshape(-1, 3)
    scene, theta = scene_of(1.2 * aims), torch.tensor([*place, 0.0, 0.0, 0.0], dtype=torch.float64)
    rendering = drawn(scene, ["range_noise"], theta, range_noise_m=0.5)
    points, directions = rendering.points.double(), Beams.from_scene(scene).directions
    off = (points - rendering.range_m[:, None] * directions).abs()
    half_a_step = 0.5 * (torch.nextafter(rendering.points, torch.tensor(torch.inf)) - rendering.points).double()
    assert rendering.hit_mask.all() and (off <= 1.001 * half_a_step).all()


@hard_case(
    area=AREA,
    why="one flipped bit makes a reflectance of 1e38, and it is on no scale",
    must="the scale of all others, 0 to 1",
    guard="up to one value in twenty may lie beyond a scale",
)
def a_reflectance_with_a_flipped_bit() -> None:
    values = np.linspace(0.0, 1.0, 40).astype(np.float32)
    values[7] = 1e38
    assert full_reflectance(values, "file.bin") == 1.0


@hard_case(
    area=AREA,
    why="NaN is neither too small nor too large, and all reflectance would be NaN",
    must="an error that names the file",
    guard="a stated maximum must lie within its bounds",
)
def a_largest_reflectance_that_is_not_a_number() -> None:
    refused(lambda: full_reflectance(np.ones(3, np.float32), "file.bin", math.nan, "Give it"), "file.bin")
