"""Assembly of a street scene: layout, first hits, returns and labels in one Scene record."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.geometry.boxes import count_in_boxes
from shift3d.scenes.facts import SceneFacts
from shift3d.scenes.scene import WEATHER_FIELDS, Conditions, Labels, Scene
from shift3d.scenes.sensor import SensorModel
from shift3d.scenes.street.build.fleet import fleet_of
from shift3d.scenes.street.build.layout import Layout, sample_layout
from shift3d.scenes.street.build.world import PlacedVehicle, World
from shift3d.scenes.street.options import PLAIN, StreetOptions, check_choice
from shift3d.scenes.street.raycast import Sweep
from shift3d.scenes.street.returns import Echoes, Paint, finish, no_return_beams, sensor_model
from shift3d.scenes.street.second_hits import second_returns
from shift3d.scenes.street.sensors import BEAMS, SENSORS, Mount, Sensor, other_heads, side_sensors
from shift3d.seeding import generator


def street_scene(split: str, seed: int, index: int, sensor_name: str, options: StreetOptions = PLAIN) -> Scene:
    """Generate one procedural scene, with the same bytes for the same arguments.

    Args:
        split: "train", "val" or "test": disjoint layouts and disjoint vehicles.
        seed, index: identify the scene.
        sensor_name: "hdl64" or "waymo_top": sensor of the street's layout; it also scans the street if options.beams is
            None. Other beams start at the same point and meet the same objects in the same places.
        options: further properties of the scene on the same street, and its traffic.

    Returns: A scene with reflectance, firing times and, with a single sensor, range-image indices. Rows: the main
    sensor's first returns, row by row of its range image, independent of other returns and sensors; then second returns
    in that order, or each side sensor's returns. Labels are vehicles, pedestrians and cyclists with at least one point
    in their box. If the sensor moves, boxes and counts are those of time 0: points in the moving sensor's frame lie
    beside them.

    Raises InputError: an unknown sensor or split, or held-out traffic on training streets. Source: our choice.
    """
    sensor = _sensor_of_streets(sensor_name)
    parts = ("street-scene", split, seed, index, sensor_name)
    layout, world = _street(parts, sensor, options)
    seen_by = scanning_sensor(sensor, options)
    echoes, sweeps, second = _sense(world, layout, seen_by, options, parts)
    compensated = options.motion_compensated
    return Scene(
        scene_id=f"street-{split}-{sensor_name}-{index:06d}{options.tag}" + (f"-seed{seed}" if seed else ""),
        dataset=f"street-{sensor_name}{options.tag}",
        points=echoes.points,
        origins=echoes.origins,
        ground_z_m=-sensor.mount_height_m,
        labels=_labels(layout, world, _at_time_0(echoes, options)),
        reflectance=echoes.reflectance,
        return_number=second if options.returns > 1 else None,
        time_s=echoes.time_s,
        range_image_index=echoes.pixel if len(sweeps) == 1 else None,
        conditions=conditions_of(options),
        sensor=sensor_model(seen_by) if options.sensor_model else None,
        no_return=no_return_beams(sweeps, compensated) if options.range_image else None,
    )


def street_vehicles(
    split: str, seed: int, index: int, sensor_name: str, options: StreetOptions = PLAIN
) -> tuple[PlacedVehicle, ...]:
    """Return all vehicles of `street_scene` with their meshes, hit or not: the ground truth behind labels."""
    parts = ("street-scene", split, seed, index, sensor_name)
    return _street(parts, _sensor_of_streets(sensor_name), options)[1].vehicles


def _sensor_of_streets(name: str) -> Sensor:
    check_choice("sensor", name, SENSORS)
    return SENSORS[name]


def _street(parts: tuple[str | int, ...], sensor: Sensor, options: StreetOptions) -> tuple[Layout, World]:
    fleet = fleet_of(options.traffic, str(parts[1]))
    layout = sample_layout(generator(*parts, "layout"), sensor.mount_height_m, fleet)
    return layout, World.of(layout, fleet, driven_m=options.ego_speed_m_s * sensor.turn_s)


def scanning_sensor(sensor: Sensor, options: StreetOptions) -> Sensor:
    """Return the sensor that scans a sensor's street, at the same height."""
    return sensor if options.beams is None else replace(BEAMS[options.beams], mount_height_m=sensor.mount_height_m)


def _sense(
    world: World, layout: Layout, sensor: Sensor, options: StreetOptions, parts: tuple[str | int, ...]
) -> tuple[Echoes, list[tuple[Sweep, NDArray[np.bool_]]], NDArray[np.uint8]]:
    """Return all returns, each sensor's sweep with the mask of its kept beams, and the mask (N,) of second returns."""
    # Options draw from their own generators: the main sensor's first returns do not depend on options.
    compensated = options.motion_compensated
    if options.beams:
        parts = (*parts, "beams", options.beams)
    rng = generator(*parts, "sensing")
    main = Sweep.empty(sensor, Mount(speed_m_s=options.ego_speed_m_s))
    world.cast(main, rng)
    # The number of draws in casting depends on the beams; the vehicles' paint must not.
    paint = _sample_paint(layout, rng if options.beams is None else generator(*parts[:-2], "paint"))
    range_m, reflectance, kept = finish(main, paint, rng)
    echoes = [Echoes.of_kept(main, kept, range_m, reflectance, compensated)]
    sweeps = [(main, kept)]
    if options.returns > 1:
        second = second_returns(world, main, range_m, kept, paint, generator(*parts, "second returns"))
        echoes.append(Echoes.of(main, *second, compensated))
    beside = side_sensors(sensor, options.sensors - 1, options.ego_speed_m_s)
    for number, (model, mount) in enumerate([*beside, *other_heads(sensor, options.ego_speed_m_s)]):
        rng = generator(*parts, "side sensor", number)
        side = Sweep.empty(model, mount)
        world.cast(side, rng)
        range_m, reflectance, kept = finish(side, paint, rng)
        echoes.append(Echoes.of_kept(side, kept, range_m, reflectance, compensated))
        sweeps.append((side, kept))
    joined = Echoes.joined(echoes)
    is_second = (np.arange(len(joined.points)) >= len(echoes[0].points)) & (options.returns > 1)
    return joined, sweeps, is_second.astype(np.uint8)


def conditions_of(options: StreetOptions) -> Conditions:
    """Return the conditions: weather that the points do not contain; default values for dry, static streets."""
    velocity = (float(options.ego_speed_m_s), 0.0, 0.0) if options.ego_speed_m_s else None
    field = WEATHER_FIELDS.get(options.weather)
    strength: dict[str, Any] = {field: getattr(options, field)} if field else {}
    return Conditions(
        **strength,
        weather=options.weather,
        ego_velocity_m_s=velocity,
        weather_in_points=options.weather == "dry",
        motion_compensated=velocity is None or options.motion_compensated,
    )


def _at_time_0(echoes: Echoes, options: StreetOptions) -> NDArray[np.float32]:
    """Return the points (N, 3) in the frame of the sensor at time 0."""
    if not options.ego_speed_m_s or options.motion_compensated:
        return echoes.points
    driven = options.ego_speed_m_s * echoes.time_s.astype(np.float64)[:, None] * np.array([1.0, 0.0, 0.0])
    points: NDArray[np.float32] = (echoes.points + driven).astype(np.float32)
    return points


def _sample_paint(layout: Layout, rng: np.random.Generator) -> dict[int, Paint]:
    """Draw the albedo of each vehicle's body and the loss of its windows."""
    paint = {}
    for number, item in enumerate(layout.items):
        if item.kind == "vehicle":
            glass_loss = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.2, 0.9))
            paint[number] = Paint(albedo=float(rng.uniform(0.05, 0.7)), glass_loss=glass_loss)
    return paint


def _labels(layout: Layout, world: World, points: NDArray[np.float32]) -> Labels:
    numbers = sorted(world.boxes)
    stacked = np.array([world.boxes[number] for number in numbers]).reshape(-1, 7)
    counts = count_in_boxes(points, stacked)
    seen = np.flatnonzero(counts > 0)
    names = tuple(layout.items[numbers[i]].kind for i in seen)
    kinds = {placed.number: placed.vehicle.kind for placed in world.vehicles if placed.vehicle.kind}
    known = tuple(kinds.get(numbers[i], "") for i in seen) if kinds else ()
    return Labels(stacked[seen], names, counts[seen], kinds=known)


def street_facts(scene_id: str, sensor_name: str, options: StreetOptions) -> SceneFacts:
    """Return the facts of a street scene from its sensor and options; effects decide as for the generated scene.

    The generated scene may differ in two numbers that affect no decision: here ``no_return_beams`` counts the beams
    that the sensor drops at random, and ``scan_s`` is the whole turn in float32. The ground is always in view.
    """
    sensor = scanning_sensor(SENSORS[sensor_name], options)
    heads = other_heads(sensor, options.ego_speed_m_s)
    times = sensor.firing_times_s().astype(np.float32)
    beams = len(sensor.elevations_rad) * sensor.columns * (1 + len(heads))
    moving_origins = options.motion_compensated and options.ego_speed_m_s > 0.0
    return SceneFacts(
        scene_id=scene_id,
        origins=2 if options.sensors > 1 or heads or moving_origins else 1,
        returns=options.returns,
        no_return_beams=round(sensor.drop_rate * beams) if options.range_image else 0,
        has_reflectance=True,
        has_pixels=options.sensors == 1 and not heads,
        scan_s=float(times.max() - times.min()),
        sensor=sensor_model(sensor) if options.sensor_model else SensorModel(),
        conditions=conditions_of(options),
    )
