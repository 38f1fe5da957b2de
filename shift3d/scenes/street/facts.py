"""What a street's configuration says of its scenes, without making them."""

from __future__ import annotations

import numpy as np

from shift3d.scenes.facts import SceneFacts
from shift3d.scenes.sensor import SensorModel
from shift3d.scenes.street.assemble import conditions_of, seeing
from shift3d.scenes.street.options import StreetOptions
from shift3d.scenes.street.returns import sensor_model
from shift3d.scenes.street.sensors import companions, sensor_named


def street_facts(scene_id: str, sensor_name: str, options: StreetOptions) -> SceneFacts:
    """The facts of a street scene by its sensor and options; effects decide on them as on those of the made scene.

    A made scene may differ in two numbers that decide nothing: ``no_return_beams`` are here those that the sensor drops
    at random, ``scan_s`` is that of the whole turn in float32. On a street the ground is always in view.
    """
    sensor = seeing(sensor_named(sensor_name), options)
    heads = companions(sensor, options.ego_speed_m_s)
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
