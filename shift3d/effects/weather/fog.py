"""Fog: extinction on the way there and back, and backscatter from the fog itself."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns, ReturnsStep, WeatherEffect, unchanged
from shift3d.effects.physics.pairing import BeamReturns
from shift3d.effects.physics.power import LEAST_LOSS, OVERLAP_FROM_M, DetectionLoss, echo_power, loss, overlap, reach_m
from shift3d.scenes.facts import DetectorFacts, SceneFacts

PULSE_S = 20e-9
"""tau, half the length of the sin^2 pulse: its width at half height."""
TARGET_REFLECTIVITY = 1e-6
"""Gamma. beta_0 = Gamma / pi is the reference of the fog's backscatter."""
LIGHT_M_S = 299_792_458.0
_DEPTHS, _PEAKS, _NODES = 200, 200, 3000


def extinction_per_m(visibility_m: float) -> float:
    """Compute alpha = ln 20 / MOR, 1/m: 5 % of the light is left at the meteorological optical range."""
    return math.log(20.0) / visibility_m


def backscatter_per_m(visibility_m: float) -> float:
    """Compute beta = 0.046 / MOR, 1/(m sr). Source: Hahner et al. 2021."""
    return 0.046 / visibility_m


@dataclass(frozen=True)
class FogEcho:
    """Table over R0 of the fog's echo in front of a surface at range R0.

    depth_m: (D,) R0, ascending. log_gain: (D,) log of beta / beta_0 * max over R of the integral over the pulse, times
    exp(2 alpha 0.9 m); without this factor dense fog underflows float64. range_m: (D,) reported range of the echo.
    """

    extinction_per_m: float
    depth_m: NDArray[np.float64]
    log_gain: NDArray[np.float64]
    range_m: NDArray[np.float64]

    def at(self, range_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute the log ratio of the fog's echo to the surface's echo in clear air, and the fog's reported range.

        Args:
            range_m: (K,) of the surfaces, metres. Below 0.9 m the receiver sees no fog in front of a surface: -inf.
        """
        # Beyond the last depth the echo is constant; most surfaces lie there.
        log_gain, reported_m = np.full_like(range_m, self.log_gain[-1]), np.full_like(range_m, self.range_m[-1])
        near = np.nonzero(range_m < self.depth_m[-1])[0]
        log_gain[near] = np.interp(range_m[near], self.depth_m, self.log_gain, left=-np.inf)
        reported_m[near] = np.interp(range_m[near], self.depth_m, self.range_m)
        log_ratio = log_gain + 2.0 * np.log(np.maximum(range_m, OVERLAP_FROM_M))
        return log_ratio - 2.0 * self.extinction_per_m * OVERLAP_FROM_M, reported_m


@functools.cache
def fog_echo_table(extinction: float, backscatter: float) -> FogEcho:
    """Tabulate the echo of fog.

    With r = R - c t / 2 in place of t, the integral over the pulse is that of sin^2(pi (R - r) / (c tau)) * w(r), w(r)
    = xi(r) exp(-2 alpha r) / r^2, for r below R0 and within c tau behind R. As sin^2 x = (1 - cos 2x) / 2, three
    running integrals of w give it for every R and R0. The pulse is symmetric and w starts at 0.9 m. The maximum over R
    therefore lies between c tau / 2 and c tau beyond 0.9 m, and the pulse's tail always covers the start of w.

    Args:
        extinction, backscatter: alpha, 1/m, and beta, 1/(m sr).

    Source: Hahner et al. 2021, equations only.
    """
    length = LIGHT_M_S * PULSE_S
    wave = 2.0 * math.pi / length
    first = 1e-3 / (1.0 + extinction)
    behind = np.concatenate(([0.0], np.geomspace(first, length, _NODES)))
    behind = np.unique(np.append(behind, 0.1))  # the kink of xi
    node = OVERLAP_FROM_M + behind
    weight = overlap(torch.from_numpy(node)).numpy() * np.exp(-2.0 * extinction * behind) / node**2
    running = [_running(behind, weight * part) for part in (1.0, np.cos(wave * behind), np.sin(wave * behind))]
    depth = np.geomspace(first, length, _DEPTHS)
    # peak: reported range of an echo whose maximum is received half a pulse later.
    peak = np.linspace(0.0, length / 2.0, _PEAKS)
    end = np.minimum(peak + length / 2.0, depth[:, None])
    whole, even, odd = (np.interp(end, behind, values) for values in running)
    angle = wave * (peak + length / 2.0)
    received = (whole - np.cos(angle) * even - np.sin(angle) * odd) / LIGHT_M_S
    best, at = _maximum(received, peak)
    gain = backscatter / (TARGET_REFLECTIVITY / math.pi) * best
    return FogEcho(extinction, OVERLAP_FROM_M + depth, np.log(gain), OVERLAP_FROM_M + np.minimum(at, depth))


def _running(x: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integrate from the first node up to each node, by the trapezoidal rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(x))))


def _maximum(values: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the maximum along rows (D, P) by a parabola through the three largest samples; x evenly spaced."""
    row = np.arange(len(values))
    middle = np.clip(values.argmax(axis=1), 1, values.shape[1] - 2)
    before, here, after = (values[row, middle + offset] for offset in (-1, 0, 1))
    curvature = before - 2.0 * here + after
    shift = np.clip(np.where(curvature < 0.0, 0.5 * (before - after) / np.minimum(curvature, -1e-300), 0.0), -1.0, 1.0)
    return here - 0.25 * (before - after) * shift, x[middle] + shift * (x[1] - x[0])


class Fog(WeatherEffect):
    """The stronger of two echoes: that of the surface, exp(-2 alpha R0), and that of the fog in front of it.

    If the fog's echo wins, the point moves along the beam to the range of that echo's maximum. An echo's maximum
    arrives half a pulse (c tau / 2, 3 m) after the first light. A sensor that reports a surface at R0 subtracts that
    delay, so that it is subtracted from the fog's echo too, and the point never lies behind the surface. Only the first
    return of a beam can show fog: a later return that the fog outshines is lost (our choice). This range has no noise:
    the authors' code scatters it by one of four random factors that the equations do not contain; our choice is the
    smooth fog of the equations. An echo of fog is not from the object (`on_object` False) and has cosine 1.

    A surface's echo is lost below the sensor's least power, if that is known (`power.DetectionLoss`). The fog's echo is
    not tested: its calibration (Gamma) relates it to the echo of surfaces, not to the scale of albedo. As in the
    published method it is proportional to the reflectance of the surface behind it.

    Also changes reflectance, as a sensor reports it (power times range squared), and albedo, which becomes the apparent
    albedo through the fog, so that later effects weaken the rest. Leaves unchanged: directions, cosine of surfaces,
    points that the fog does not outshine, rows without a return (fog in front of the sky is neglected). Unlimited
    visibility changes nothing.

    With rain and snow: each effect acts on the result of the one before. Extinctions add up as they should. Two things
    are left out: the fog's extinction on echoes of drops and flakes in front of the surface, and the rain's extinction
    on the fog's echo beyond the echo's own range.

    Differentiable: points that stay. The gradient ignores the loss and replacement of echoes and the range at which
    they happen; points of fog, reflectance and albedo carry none.

    Source: Hahner et al. 2021, equations; range correction as in the authors' code (a maximum received later than R0
    counts here, too); noise and least power: our choice.
    """

    name = "fog"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if 1 % of the light is lost within the scene's reach and the loss can show: in reflectance,
        at the sensor's limit, or because fog outshines surfaces."""
        visibility_m = scene.conditions.visibility_m
        extinction, reach = extinction_per_m(visibility_m), reach_m(scene.conditions)
        if loss(extinction, reach) < LEAST_LOSS:
            return None
        outshone_m = _outshone_from_m(visibility_m, reach)
        read = detector.reads_reflectance and scene.has_reflectance
        if scene.sensor.limit_range_m is None and outshone_m is None and not read:
            return None
        reason = f"visibility {visibility_m:g} m: {100.0 * loss(extinction, 30.0):.0f} % of the light is lost "
        reason += "at 30 m and back"
        return reason if outshone_m is None else f"{reason}; fog outshines surfaces from {outshone_m:.0f} m on"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Tabulate the echo once for each visibility in a process. Draws two values a beam if the limit is known."""
        visibility_m = context.scene.conditions.visibility_m
        if math.isinf(visibility_m):
            return unchanged
        limit = DetectionLoss.of(context, self.name)
        soft = fog_echo_table(extinction_per_m(visibility_m), backscatter_per_m(visibility_m))
        paired = BeamReturns.of(context)
        later = None if paired is None else paired.later
        return lambda returns: _in_fog(returns, soft, limit, later)


def _in_fog(returns: Returns, soft: FogEcho, limit: DetectionLoss, later: Tensor | None) -> Returns:
    range_m = returns.range_m.detach()
    log_hard = -2.0 * soft.extinction_per_m * range_m
    log_soft, soft_m = (torch.from_numpy(values) for values in soft.at(range_m.numpy()))
    fog = returns.returned & (log_soft > log_hard)
    transmission = torch.exp(log_hard)
    power = echo_power(returns.albedo, returns.cosine, range_m)
    lost = limit.lost(returns.without(fog), power, transmission)
    if later is not None:
        lost |= fog & later[returns.row]
    rows = fog.nonzero().squeeze(1)
    # Reported reflectance: power times the square of the reported range.
    nearness = soft_m[rows] / range_m[rows]
    left = torch.where(returns.returned, transmission, 1.0)
    left = left.index_copy(0, rows, torch.exp(log_soft[rows]) * nearness**2)
    albedo = returns.albedo.index_copy(0, rows, returns.albedo[rows] * returns.cosine[rows])
    changed = replace(
        returns.without(lost).moved_to(soft_m[rows], rows),
        on_object=returns.on_object & ~fog,
        albedo=(albedo * left).clamp(max=1.0),
        cosine=returns.cosine.index_fill(0, rows, 1.0),
    )
    reflectance = returns.reflectance
    return changed if reflectance is None else replace(changed, reflectance=(reflectance * left).clamp(max=1.0))


def _outshone_from_m(visibility_m: float, reach: float) -> float | None:
    """Find the range beyond which fog outshines surfaces, to half a metre; None if it lies beyond reach."""
    range_m = np.arange(1.0, reach, 0.5)
    soft = fog_echo_table(extinction_per_m(visibility_m), backscatter_per_m(visibility_m))
    won = soft.at(range_m)[0] > -2.0 * soft.extinction_per_m * range_m
    return float(range_m[won.argmax()]) if won.any() else None


EFFECT = Fog()
