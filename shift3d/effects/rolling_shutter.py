"""Rolling shutter: each beam meets the object at the object's position at the beam's firing time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.effects.base import Cast, CastStep, Effect, EffectContext, Kind
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions

ASSUMED_NOISE_M = 0.02
"""Range noise of a sensor that states none. Our choice: the usual value in data sheets of spinning sensors."""


class RollingShutter(Effect):
    """Displacement of the object by d = v t at a beam's firing time t. The object's pose is that of the scene's time 0.

    v is the velocity of the object. If points are not motion compensated, each return is in the frame of the sensor at
    its firing time, and the sensor's velocity is subtracted. Compensated points have origins that follow the sensor;
    the effect `origins` uses them. Beams are cast displaced by -d and their hits are moved back by d (`Cast.shift_m`),
    so that a hit lies on the beam as the sensor knows it.

    Returns that do not meet the object stay unchanged; at velocity 0 everything does, bit for bit. Differentiable
    through the hits. The velocity is constant, along the heading at the placement: a change of yaw does not turn it,
    and the sensor's rotation during the scan is not known. No-return beams without firing times meet the object at its
    pose. Source: shared physics, x(t) = x0 + v (t - t_ref).
    """

    name = "rolling_shutter"
    kind: Kind = "cast"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if the displacement over a scan exceeds the range noise.

        The facts do not contain the heading: the sum of both speeds gives an upper bound of the displacement.
        """
        speed = abs(scene.object_speed_m_s) + float(np.linalg.norm(_apparent(scene.conditions)))
        moved, noise = speed * scene.scan_s, scene.sensor.range_noise_m or ASSUMED_NOISE_M
        if not moved > noise:
            return None
        return f"up to {speed:.1f} m/s over {scene.scan_s:.3g} s: {moved:.2f} m, range noise {noise:.2f} m"

    def bind(self, context: EffectContext) -> CastStep:
        velocity = relative_velocity(context)
        scene = context.scene
        if scene.time_s is None or not velocity.any():
            return lambda cast: cast
        times = torch.from_numpy(scene.time_s.copy()).double()
        no_return = None if scene.no_return is None else scene.no_return.time_s
        no_return_times = None if no_return is None else torch.from_numpy(no_return.copy()).double()
        return lambda cast: _displaced(cast, times, no_return_times, torch.from_numpy(velocity))


def relative_velocity(context: EffectContext) -> NDArray[np.float64]:
    """Compute the object's velocity (3,) float64, m/s, in the frame of the points, scene axes."""
    heading = context.heading_rad
    own: NDArray[np.float64] = context.object_speed_m_s * np.array([math.cos(heading), math.sin(heading), 0.0])
    return own - _apparent(context.scene.conditions)


def _apparent(conditions: Conditions) -> NDArray[np.float64]:
    """Return the velocity (3,) of the frame of the points, m/s, scene axes."""
    velocity = conditions.ego_velocity_m_s
    if conditions.motion_compensated or velocity is None:
        return np.zeros(3)
    return np.array(velocity, dtype=np.float64)


def _displaced(cast: Cast, times: Tensor, no_return_times: Tensor | None, velocity: Tensor) -> Cast:
    """Displace the beams against the object. times (N,): of the scene's points; no-return rows follow."""
    beams = cast.beams
    extra = len(beams) - len(times)
    if extra:
        times = torch.cat((times, times.new_zeros(extra) if no_return_times is None else no_return_times))
    shift = times[:, None] * velocity
    moved = replace(beams, origins=beams.origins - shift, points=(beams.points.double() - shift).to(beams.points.dtype))
    return replace(cast, beams=moved, shift_m=shift)


EFFECT = RollingShutter()
