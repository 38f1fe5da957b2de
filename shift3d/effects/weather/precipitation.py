"""Rain and snow: particles in the beam weaken echoes and return their own."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns, ReturnsStep, WeatherEffect, unchanged
from shift3d.effects.physics import power as law
from shift3d.effects.physics.pairing import BeamReturns
from shift3d.effects.physics.power import LEAST_LOSS, OVERLAP_FROM_M, DetectionLoss, echo_power, loss
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

EXIT_M, DIVERGENCE_RAD = 0.01, 2e-3
"""Width of a beam at the sensor, and its full angle if the sensor states none (our choice: HDL-64E)."""
LEAST_ALBEDO = 0.01
"""Least albedo behind an echo: a reported 0 is a rounding, not a surface that any particle outshines (our choice)."""
PULSE_M = 0.09
"""Range accuracy Delta R of LISA (Kilic et al. 2021); a strong echo's noise is a small part of it."""
EXTINCTION_EFFICIENCY = 2.0
"""Q_ext of particles much larger than the wavelength: pi D / wavelength is 3500 for a drop of 1 mm at 905 nm."""
_FAR_M, _LEAST_POWER, _MOST_POWER = 250.0, 1e-10, 10.0
_RANGES, _POWERS = 512, 256


@dataclass(frozen=True)
class Particles:
    """Particles in the air with the size distribution N(D) = density exp(-slope D), D in mm.

    density: 1/(m^3 mm). slope: 1/mm. albedo: of a diffuse disc that sends back as much light.
    """

    density: float
    slope: float
    albedo: float

    @functools.cached_property
    def extinction_per_m(self) -> float:
        """alpha = 1e-6 (pi / 4) integral of D^2 Q_ext N(D) over D in mm, 1/m; 1e-6 converts mm^2 to m^2."""
        u, weight = np.polynomial.laguerre.laggauss(16)  # u = slope D, with exp(-u) in the weights
        diameter = u / self.slope
        integral = (weight * diameter**2 * EXTINCTION_EFFICIENCY).sum() * self.density / self.slope
        return 1e-6 * math.pi / 4.0 * float(integral)

    @property
    def number_density_per_m3(self) -> float:
        """Number of particles of all sizes, 1/m^3."""
        return self.density / self.slope


def weather_range_noise_m(power: Tensor, transmission: Tensor, least: float) -> Tensor:
    """Compute the additional range noise (K,) of weakened echoes, standard deviation in metres; 0 if no light is lost.

    Args:
        power, least: (K,) power before the weather, and the sensor's least power, 1/m^2. transmission: (K,) in [0, 1].

    A range scatters by PULSE_M / sqrt(2 SNR), SNR = power / least power, at least 1 for a detected echo. The difference
    of the variances is added, because scene and sensor have the noise of clear air already.

    Source: Kilic et al. 2021. Not the 0.02 R (1 - exp(-rate))^2 of Goodin et al. 2019: that is 0.4 m at 20 m in any
    rain above 3 mm/h, fifty times what sensors show; with it, rain took 0.69 of a score of 0.84 by noise alone.
    """
    before = (least / power.clamp(min=least)).clamp(max=1.0)
    after = (least / (power * transmission).clamp(min=least)).clamp(max=1.0)
    return PULSE_M / math.sqrt(2.0) * (after - before).clamp(min=0.0).sqrt()


@dataclass(frozen=True)
class Crossings:
    """Expected numbers of particles in the beam that send back more than a given power.

    expected: (P, J), for power P, 1/m^2, log-spaced, and ranges below J, metres, log-spaced from 0.9 m.
    """

    particles: Particles
    divergence_rad: float
    expected: NDArray[np.float64]

    def width_m(self, range_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the diameter of the beam."""
        return EXIT_M + self.divergence_rad * range_m

    def least_mm(self, power: NDArray[np.float64], range_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the diameter of the smallest particle that sends back a power; infinite if none is wide enough.

        A particle covers the share s = (D / width)^2 of the beam and sends back albedo s xi(r) exp(-2 alpha r) / r^2.
        """
        seen = law.overlap(torch.from_numpy(range_m)).numpy() * np.exp(-2.0 * self.particles.extinction_per_m * range_m)
        share = power * range_m**2 / np.maximum(self.particles.albedo * seen, 1e-300)
        return np.where(share <= 1.0, 1e3 * self.width_m(range_m) * np.sqrt(share), np.inf)

    def nearest(
        self, power: NDArray[np.float64], range_m: NDArray[np.float64], arrival: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute the range of the nearest particle that sends back more than a power.

        Particles are a Poisson process along the beam with mean number Lambda(r) nearer than r. The nearest particle
        lies at Lambda(r) = E, E exponential with mean 1.

        Args:
            power, range_m: (K,) power to exceed, and range at which the search stops. arrival: (K,) the draws E.

        Returns: (K,) metres; infinite if there is none.
        """
        row = _index(power, _LEAST_POWER, _MOST_POWER, _POWERS)
        stop = _index(range_m, OVERLAP_FROM_M, _FAR_M, _RANGES)
        found = np.full(len(power), np.inf)
        met = np.nonzero(arrival < self._between(row, stop))[0]
        where = self._where(row[met], arrival[met]) / (_RANGES - 1)
        found[met] = OVERLAP_FROM_M * np.exp(where * math.log(_FAR_M / OVERLAP_FROM_M))
        return found

    def _column(self, row: NDArray[np.float64], column: NDArray[np.int64]) -> NDArray[np.float64]:
        low = np.minimum(row.astype(np.int64), _POWERS - 2)
        part = row - low
        blend: NDArray[np.float64] = (1.0 - part) * self.expected[low, column] + part * self.expected[low + 1, column]
        return blend

    def _between(self, row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.float64]:
        low = np.minimum(column.astype(np.int64), _RANGES - 2)
        part = column - low
        return (1.0 - part) * self._column(row, low) + part * self._column(row, low + 1)

    def _where(self, row: NDArray[np.float64], arrival: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the column at which `expected` reaches the arrival, by bisection; expected never falls along a row."""
        low, high = np.zeros(len(row), np.int64), np.full(len(row), _RANGES - 1)
        for _ in range(_RANGES.bit_length()):
            middle = (low + high) // 2
            reached = self._column(row, middle) > arrival
            high, low = np.where(reached, middle, high), np.where(reached, low, middle)
        before, after = self._column(row, low), self._column(row, high)
        return low + (arrival - before) / np.maximum(after - before, 1e-300) * (high - low)


def _index(values: NDArray[np.float64], first: float, last: float, count: int) -> NDArray[np.float64]:
    """Compute the fractional index of values among `count` log-spaced ones, clipped to the ends."""
    place = np.log(np.maximum(values, first) / first) * ((count - 1) / math.log(last / first))
    return np.minimum(place, count - 1.0)


@functools.cache
def crossings(particles: Particles, divergence_rad: float) -> Crossings:
    """Tabulate the expected numbers of particles that send light back into a beam.

    Lambda(p, R) = integral over r from 0.9 m to R of (pi / 4) width(r)^2 n(D > D_min(p, r)),
    n(D > x) = density / slope exp(-slope x).
    """
    empty = Crossings(particles, divergence_rad, np.zeros((0, 0)))
    power = np.geomspace(_LEAST_POWER, _MOST_POWER, _POWERS)[:, None]
    edge = np.geomspace(OVERLAP_FROM_M, _FAR_M, _RANGES)
    middle = 0.5 * (edge[1:] + edge[:-1])  # the overlap at 0.9 m is 0
    counted = particles.number_density_per_m3 * np.exp(-particles.slope * empty.least_mm(power, middle))
    steps = counted * math.pi / 4.0 * empty.width_m(middle) ** 2 * np.diff(edge)
    return replace(empty, expected=np.concatenate((np.zeros((_POWERS, 1)), np.cumsum(steps, axis=1)), axis=1))


@dataclass(frozen=True)
class ParticleEchoes:
    """Particles in front of the surfaces that beams meet.

    arrival, size: (N,) exponential draws for position and width of a beam's nearest particle; equal for all returns of
    a beam. noise: (N,) normal draws. later: (N,) bool, returns behind another of their beam; None: there are none.
    """

    crossings: Crossings
    limit: DetectionLoss
    arrival: Tensor
    size: Tensor
    noise: Tensor
    later: Tensor | None = None

    @staticmethod
    def of(context: EffectContext, effect: str, particles: Particles) -> ParticleEchoes:
        """Draw the particles in the beams of a context."""
        sensor = context.scene.sensor or SensorModel()
        paired = BeamReturns.of(context)
        drawn = (
            torch.from_numpy(context.draws(effect, what).standard_exponential(len(context.beams)))
            for what in ("arrival", "size")
        )
        arrival, size = (values if paired is None else values[paired.beam] for values in drawn)
        table = crossings(particles, sensor.divergence_rad or DIVERGENCE_RAD)
        noise = torch.from_numpy(context.draws(effect, "noise").standard_normal(len(context.beams)))
        later = None if paired is None else paired.later
        return ParticleEchoes(table, DetectionLoss.of(context, effect), arrival, size, noise, later)

    def act(self, returns: Returns) -> Returns:
        """Weaken echoes, remove those that are too weak, and replace echoes by the nearest particle that exceeds them.

        A particle replaces the echo behind it if it sends back more, and at least the sensor's least power. Later
        returns of a beam that a particle exceeds are lost.
        """
        range_m = returns.range_m.detach()
        transmission = torch.exp(-2.0 * self.crossings.particles.extinction_per_m * range_m)
        power = echo_power(returns.albedo, returns.cosine, range_m)
        lost = self.limit.lost(returns, power, transmission)
        seen = echo_power(returns.albedo.clamp(min=LEAST_ALBEDO), returns.cosine, range_m) * transmission
        power_to_exceed = seen.clamp(min=self.limit.least).numpy()
        nearest = self.crossings.nearest(power_to_exceed, range_m.numpy(), self.arrival[returns.row].numpy())
        particle = returns.returned & torch.from_numpy(np.isfinite(nearest))
        surface = returns.returned & ~particle & ~lost
        outdone_later = torch.zeros_like(particle) if self.later is None else particle & self.later[returns.row]
        left = torch.where(returns.returned, transmission, 1.0)
        changed = replace(
            returns.without((lost & ~particle) | outdone_later),
            on_object=returns.on_object & ~particle,
            albedo=returns.albedo * left,
            cosine=torch.where(particle, 1.0, returns.cosine),
            reflectance=None if returns.reflectance is None else returns.reflectance * left,
        )
        if self.limit.least > 0.0:
            weak = echo_power(returns.albedo.clamp(min=LEAST_ALBEDO), returns.cosine, range_m)
            shift = self.noise[returns.row] * weather_range_noise_m(weak, transmission, self.limit.least)
            points = torch.where(surface[:, None], changed.points + shift[:, None] * changed.directions, changed.points)
            changed = replace(changed, points=points)
        return self._with_particles(changed, particle, nearest, power_to_exceed)

    def _with_particles(
        self, returns: Returns, particle: Tensor, nearest: NDArray[np.float64], power_to_exceed: NDArray[np.float64]
    ) -> Returns:
        row, kind = particle.nonzero().squeeze(1), self.crossings.particles
        at_m = nearest[row.numpy()]
        # The exponential distribution is memoryless: the excess over a bound is distributed like the whole.
        beyond = self.size[returns.row[row]].numpy() / kind.slope
        diameter = self.crossings.least_mm(power_to_exceed[row.numpy()], at_m) + beyond
        share = np.minimum(1e-3 * diameter / self.crossings.width_m(at_m), 1.0) ** 2
        sent = torch.from_numpy(kind.albedo * share * np.exp(-2.0 * kind.extinction_per_m * at_m))
        return replace(
            returns.moved_to(torch.from_numpy(at_m), row),
            albedo=returns.albedo.index_copy(0, row, sent),
            reflectance=None if returns.reflectance is None else returns.reflectance.index_copy(0, row, sent),
        )


class Precipitation(WeatherEffect):
    """Rain or snow: `ParticleEchoes` of its particles.

    name: "rain" or "snow"; the conditions state its rate. particles: by rate, mm/h of water, above 0.

    A particle counts if its centre is in the beam, a cone of `DIVERGENCE_RAD` or of the sensor's stated divergence. It
    covers the share (D / width)^2 of the beam. Particles that exceed the echo behind them form a Poisson process along
    the beam (`crossings`). The nearest becomes the return, with the probability 1 - exp(-Lambda). Only the first return
    of a beam can show it: a later return that it exceeds is lost (our choice). Its echo is not from the object
    (`on_object` False) and has cosine 1 and the apparent albedo of its power. All other particles weaken the echo
    behind them by their mean extinction.

    Echoes of surfaces are lost below the sensor's least power, if that is known, and their ranges scatter by
    `weather_range_noise_m` along the beam. Reflectance and albedo become those seen through the particles. Leaves
    unchanged: directions, cosine of surfaces, rows without a return (particles in front of the sky are neglected). A
    rate of 0 changes nothing.

    With fog and each other: each effect acts on the result of the one before. Extinctions add up as they should; the
    weather in front of a particle does not weaken the particle's echo.

    Differentiable: surfaces keep their gradients. The gradient ignores the loss and replacement of echoes and the
    noise's dependence on the range; points of particles, reflectance and albedo carry none. Source: Kilic et al. 2021
    (limit and noise); the rest: our choice.
    """

    def __init__(self, name: str, particles: Callable[[float], Particles]) -> None:
        self.name, self.particles = name, particles

    def _rate_mm_h(self, conditions: Conditions) -> float:
        rate: float = getattr(conditions, f"{self.name}_mm_h")
        return rate

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if 1 % of the light is lost within the scene's reach."""
        rate = self._rate_mm_h(scene.conditions)
        if rate == 0.0:
            return None
        extinction = self.particles(rate).extinction_per_m
        if loss(extinction, law.reach_m(scene.conditions)) < LEAST_LOSS:
            return None
        lost = 100.0 * loss(extinction, 30.0)
        return f"{self.name} {rate:g} mm/h: {lost:.2g} % of the light is lost at 30 m and back"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Draw three values a beam, and two more if the sensor's limit is known."""
        rate = self._rate_mm_h(context.scene.conditions)
        return unchanged if rate == 0.0 else ParticleEchoes.of(context, self.name, self.particles(rate)).act
