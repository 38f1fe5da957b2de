"""Extreme poses, codes and scans by number, and the field evaluated without the renderer's code."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch

from shift3d.render import RenderSettings, preset
from shift3d.sdf.decoder import Decoder, load_decoder
from shift3d.training.sdf.export import CODE_NORM
from shift3d.vehicles.vehicle import BASELINES, Vehicle, baseline_vehicles

FARTHEST_M = 100.0
LONGEST_CODE = 20.0
"""Times the length of the codes that the decoder was trained with."""
BEAMS = 160
SETTINGS: dict[str, RenderSettings] = {
    "standard": preset("standard"),
    "draft": preset("draft"),
    "plain": preset("standard").with_(solver="plain_sphere_tracing"),
    "float64": preset("standard").with_(dtype=torch.float64, tolerance_m=1e-9, final_newton_m=0.0),
}
_OFTEN = ("standard", "standard", "standard", "standard", "draft", "plain", "float64")
_ANGLES = (math.pi, -math.pi, math.pi / 2, -math.pi / 2, 0.0, math.nextafter(math.pi, 0), 1e-12)
_PLACES = {"anywhere": 0.3, "near": 0.3, "about the sensor": 0.2, "at the sensor": 0.1, "on an axis": 0.1}


@dataclass(frozen=True)
class Case:
    """Scene to render. theta: (6,). code: (256,) float32. points: (N, 3) float64 returns of a sensor at the origin."""

    number: int
    settings: str
    vehicle: str
    theta: np.ndarray
    code: np.ndarray
    points: np.ndarray

    @property
    def frame(self) -> Vehicle:
        """The vehicle whose scale and axes are used."""
        return vehicles()[self.vehicle]


@functools.cache
def decoders() -> tuple[Decoder, Decoder]:
    """Return the shipped decoder in float32 and in float64."""
    return load_decoder(), load_decoder().double()


@functools.cache
def vehicles() -> dict[str, Vehicle]:
    """Return the baseline vehicles."""
    return baseline_vehicles()


def make_case(number: int) -> Case:
    """Return a pose, a code and a scan; the same for the same number."""
    rng = np.random.default_rng((20, number))
    vehicle = BASELINES[number % len(BASELINES)]
    theta = np.concatenate((_place(rng), _angles(rng)))
    code = rng.normal(size=len(vehicles()[vehicle].latent_code))
    if rng.random() < 0.5:
        code = vehicles()[vehicle].latent_code.astype(np.float64)
    share = rng.choice([0.0, 1.0, rng.uniform(0.0, LONGEST_CODE), LONGEST_CODE], p=[0.05, 0.25, 0.6, 0.1])
    code = code / np.linalg.norm(code) * CODE_NORM * share
    settings = str(rng.choice(_OFTEN))
    return Case(number, settings, vehicle, theta, code.astype(np.float32), _scan(rng, theta))


def _place(rng: np.random.Generator) -> np.ndarray:
    """Draw a place anywhere within 100 m, on an axis, about the sensor, or exactly at it."""
    kind = str(rng.choice(list(_PLACES), p=list(_PLACES.values())))
    if kind == "at the sensor":
        return np.zeros(3)
    if kind == "on an axis":
        return FARTHEST_M * rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
    reach = {"anywhere": FARTHEST_M, "near": 25.0, "about the sensor": 3.0}[kind]
    place: np.ndarray = rng.uniform(-reach, reach, 3)
    return place


def _angles(rng: np.random.Generator) -> np.ndarray:
    """Draw each of yaw, pitch, roll at a wrap or a right angle, or anywhere within five turns."""
    anywhere = rng.uniform(-10 * math.pi, 10 * math.pi, 3)
    return np.where(rng.random(3) < 0.5, rng.choice(_ANGLES, 3), anywhere)


def _scan(rng: np.random.Generator, theta: np.ndarray) -> np.ndarray:
    """Return (N, 3) returns: half about the object, as seen from the sensor, half anywhere; three rows have no beam."""
    about = theta[:3] + rng.uniform(-1.0, 1.0, (BEAMS // 2, 3)) * [2.6, 1.6, 1.2]
    length = np.linalg.norm(about, axis=1, keepdims=True)
    about *= rng.choice([1.0, (length.mean() + 8.0) / length.mean(), 2.0])
    anywhere = rng.normal(size=(BEAMS // 2 - 3, 3))
    anywhere *= rng.uniform(0.5, 2 * FARTHEST_M, (len(anywhere), 1)) / np.linalg.norm(anywhere, axis=1, keepdims=True)
    none = np.array([[0.0, 0.0, 0.0], [np.nan, 1.0, 1.0], [np.inf, 0.0, 0.0]])
    return np.concatenate((about, anywhere, none))


def distance_m(case: Case, points: np.ndarray) -> np.ndarray:
    """Compute metric distance (N,) at scene points (N, 3): the decoder as published, float64, frames made here."""
    yaw, pitch, roll = case.theta[3:]
    about_z = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    about_y = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    x_object = np.linalg.solve(about_z @ about_y @ about_x, (points - case.theta[:3]).T).T
    exact = decoders()[1]
    with torch.no_grad():
        code = torch.from_numpy(case.code).double().expand(len(points), -1)
        g: np.ndarray = exact(code, torch.from_numpy(case.frame.to_sdf(x_object))).numpy()
    return g * case.frame.scale_m


def along_beam(case: Case, row: int, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges (K,) every spacing_m on a return's beam, within 4.5 m of the object, and the distances there."""
    end = case.points[row]
    length = float(np.linalg.norm(end))
    middle = float(case.theta[:3] @ end) / length
    k = np.arange(middle - 4.5, middle + 4.5, spacing_m)
    k = k[(k >= 0.0) & (k <= length)]
    return k, distance_m(case, k[:, None] * end / length)
