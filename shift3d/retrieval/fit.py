"""Fit of a vehicle's shape to its visible points: coordinates of the subspace, by damped Gauss-Newton."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from shift3d.retrieval.subspace import Subspace

Array = NDArray[np.float64]
ITERATIONS = 12
NOISE_M = 0.03  # standard deviation of a surface point: errors of decoder, subspace and label together
CLAMP_M = (0.3, 0.1)
"""Distances beyond which a point's weight falls, at the first step and from the fourth step on."""
FREE_CLAMP_M = 0.3  # the same for depths of free places: a beam may pass through windows
MAX_INDEPENDENT_POINTS = 60.0  # largest number of independent points: errors of neighbouring points are alike
SHIFT_M, TURN_RAD, STRETCH = 0.05, 0.0175, 0.02
"""Standard deviations of the errors of the box's centre, its heading, and the scale that its length gives."""
_ENOUGH, _MOST_DAMPING = 1e-3, 1e4
_OUTLIER_M = 0.15


@dataclass(frozen=True)
class Fit:
    """Fitted shape.

    u: (k,) coordinates of the subspace. scale_m: metres per sdf unit. shift_m: (3,) from the box's centre to the
    shape's, object frame. turn_rad: from the box's heading to the shape's. residual_m: median distance of the points to
    the surface. outliers: share of points farther than 15 cm from it. uncertainty: (k,) standard deviations of u,
    relative to those of the known codes; 1: the points do not constrain the coordinate.
    """

    u: Array
    scale_m: float
    shift_m: Array
    turn_rad: float
    residual_m: float
    outliers: float
    uncertainty: Array


class _FitObjective:
    """Objective of one fit. surface, free: (P, 3), (Q, 3), object frame. scale_m: at no stretch.

    rotation: sdf_R_object (3, 3). precision: (k + 5,) of a state: coordinates, shift, turn, stretch. share: (P + Q,)
    weight of a place in the sum.
    """

    def __init__(
        self, subspace: Subspace, surface: Array, free: Array, scale_m: float, rotation: Array, noise_m: float
    ) -> None:
        self.subspace, self.surface, self.free = subspace, surface, free
        self.scale_m, self.rotation = scale_m, rotation
        nuisances = np.array([SHIFT_M] * 3 + [TURN_RAD, STRETCH])
        self.precision = np.concatenate((np.ones(subspace.components), nuisances**-2.0))
        parts = [np.full(len(part), min(1.0, MAX_INDEPENDENT_POINTS / max(len(part), 1))) for part in (surface, free)]
        self.share = np.concatenate(parts) / noise_m**2

    def at(self, state: Array) -> _EvaluatedState:
        """Compute the metric distances of all places, and their derivatives w.r.t. the state."""
        k = self.subspace.components
        turn, scale = state[k + 3], self.scale_m * np.exp(state[k + 4])
        own = turned(np.concatenate((self.surface, self.free)) - state[k : k + 3], -turn)
        x_sdf = torch.from_numpy(own @ self.rotation.T / scale).float()
        value, at_point, by_u = (part.double().numpy() for part in self.subspace.linearized(state[:k], x_sdf))
        normal = at_point @ self.rotation
        by_turn = normal[:, 0] * own[:, 1] - normal[:, 1] * own[:, 0]
        by_stretch = scale * value - np.einsum("ij,ij->i", normal, own)
        return _EvaluatedState(
            state, scale * value, np.column_stack((scale * by_u, -turned(normal, turn), by_turn, by_stretch))
        )

    def objective(self, at: _EvaluatedState, clamp: float) -> float:
        """Compute Geman and McClure's function of the distances plus the prior; free places count only inside."""
        squared = at.distance**2 * self._counts(at)
        data = float((self.share * squared / (1.0 + squared / self._clamps(clamp) ** 2)).sum())
        return data + float((self.precision * at.state**2).sum())

    def normal_equations(self, at: _EvaluatedState, clamp: float) -> tuple[Array, Array]:
        """Compute the Gauss-Newton Hessian (k + 5, k + 5) and gradient (k + 5,) of half of the objective."""
        weight = self.share * self._counts(at) * (1.0 + (at.distance / self._clamps(clamp)) ** 2) ** -2.0
        hessian = at.by_state.T @ (weight[:, None] * at.by_state) + np.diag(self.precision)
        return hessian, at.by_state.T @ (weight * at.distance) + self.precision * at.state

    def _clamps(self, clamp: float) -> Array:
        return np.repeat((clamp, FREE_CLAMP_M), (len(self.surface), len(self.free)))

    def _counts(self, at: _EvaluatedState) -> Array:
        return np.asarray((np.arange(len(at.distance)) < len(self.surface)) | (at.distance < 0.0), np.float64)


@dataclass(frozen=True)
class _EvaluatedState:
    """State with its distance: (P + Q,) metres, and by_state: (P + Q, k + 5)."""

    state: Array
    distance: Array
    by_state: Array


def fit_shape(
    subspace: Subspace,
    surface: Array,
    free: Array,
    length_m: float,
    scale_per_length: float,
    sdf_R_object: Array | None = None,
    noise_m: float = NOISE_M,
) -> Fit:
    """Compute the most probable shape of the subspace behind some points: the maximum of a posterior.

    The objective sums the squared distances of the points to the surface and the squared depths of free places inside
    the shape, both over `noise_m` squared and damped beyond a clamp, and a prior: the squared coordinates, and the
    squared errors of the box's centre, heading and scale in units of their standard deviations.

    Args:
        surface: (P, 3) points on the vehicle, object frame of its box, metres; free: (Q, 3) places outside of it.
        length_m: of the box. scale_per_length: metres per sdf unit of a vehicle one metre long.
        sdf_R_object: (3, 3), default the identity. noise_m: standard deviation of a point, see `NOISE_M`.
    On one thread the bytes depend on the arguments alone.
    Source: SHIFT3D, supplement, eq. reconstruction; it has no free space, no prior and a known pose. These, and the
    second-order method (Gauss-Newton with the exact derivative by the coordinates), are our choice.
    """
    rotation = np.eye(3) if sdf_R_object is None else sdf_R_object
    problem = _FitObjective(subspace, surface, free, length_m * scale_per_length, rotation, noise_m)
    at, damping, done = problem.at(np.zeros(subspace.components + 5)), 1e-2, 0
    while done < ITERATIONS and damping < _MOST_DAMPING:
        clamp = max(CLAMP_M[1], CLAMP_M[0] * (CLAMP_M[1] / CLAMP_M[0]) ** (done / 3))
        done += 1
        moved, gain = _step(problem, at, damping, clamp)
        damping = damping / 5 if gain > 0.0 else damping * 10
        if gain > 0.0:
            at = moved
        if done > 4 and 0.0 < gain < _ENOUGH * (1.0 + problem.objective(at, clamp)):
            break
    return _fit(problem, at)


def _step(problem: _FitObjective, at: _EvaluatedState, damping: float, clamp: float) -> tuple[_EvaluatedState, float]:
    """Take a damped step inside the ellipsoid. Returns its end and the decrease of the objective."""
    k = problem.subspace.components
    hessian, gradient = problem.normal_equations(at, clamp)
    state = at.state - np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
    state[:k] = problem.subspace.project(state[:k])
    moved = problem.at(state)
    return moved, problem.objective(at, clamp) - problem.objective(moved, clamp)


def _fit(problem: _FitObjective, at: _EvaluatedState) -> Fit:
    k = problem.subspace.components
    covariance = np.linalg.inv(problem.normal_equations(at, CLAMP_M[1])[0])
    away = np.abs(at.distance[: len(problem.surface)])
    return Fit(
        u=at.state[:k],
        scale_m=float(problem.scale_m * np.exp(at.state[k + 4])),
        shift_m=at.state[k : k + 3],
        turn_rad=float(at.state[k + 3]),
        residual_m=float(np.median(away)),
        outliers=float((away > _OUTLIER_M).mean()),
        uncertainty=np.sqrt(np.diag(covariance)[:k]),
    )


def turned(points: Array, angle_rad: float) -> Array:
    """Rotate points (N, 3) about z, counter-clockwise."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = points.T
    return np.stack((cos * x - sin * y, sin * x + cos * y, z), axis=1)
