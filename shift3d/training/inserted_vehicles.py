"""Training scenes with vehicles that our own renderer inserted: the detector must know decoded surfaces too.

Codes are those of the family the decoder was trained on, blended within a body type. Strongly perturbed codes
are left out on purpose: shapes far from any vehicle are what the attack is to find.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.geometry.boxes import points_in_boxes
from shift3d.render import Beams, Field, preset, render
from shift3d.sdf.decoder import Decoder
from shift3d.seeding import generator
from shift3d.training.detector_scenes import TrainingScene
from shift3d.vehicles.vehicle import Vehicle, family_vehicles, vehicle_mesh

__all__ = ["InsertableVehicle", "insertable_vehicles", "with_inserted_vehicles"]

MESH_RESOLUTION = 45  # the box needs the extent alone: good to about a centimetre
TRIES = 40
GROUND_POINTS = 20
CLEARANCE_M = 0.25
Floats = npt.NDArray[np.floating]


class ShapeDecoder(Protocol):
    """What turns a code into a field: the trained decoder, or a closed form."""

    def field(self, z: Tensor, /) -> Field: ...


@dataclass(frozen=True)
class InsertableVehicle:
    """A vehicle and the box of its decoded surface: centre in the object frame and size, metres."""

    vehicle: Vehicle
    centre_m: npt.NDArray[np.float64]
    size_m: npt.NDArray[np.float64]


def insertable_vehicles(count: int, seed: int, decoder: Decoder, path: Path | None = None) -> list[InsertableVehicle]:
    """`count` vehicles: family codes blended by up to a half with another of the same body type.

    Raises: InputError when the vehicle weights are missing. Source: our choice.
    """
    family = family_vehicles(path)
    chosen = []
    for index in range(count):
        rng = generator("insertable vehicle", seed, index)
        one = family[int(rng.integers(len(family)))]
        alike = [vehicle for vehicle in family if vehicle.body_type == one.body_type]
        other, share = alike[int(rng.integers(len(alike)))], rng.uniform(0.0, 0.5)
        blended = Vehicle(
            name=f"{one.body_type}-{index}",
            body_type=one.body_type,
            latent_code=((1 - share) * one.latent_code + share * other.latent_code).astype(np.float32),
            scale_m=float(((1 - share) * one.scale_m + share * other.scale_m) * rng.uniform(0.95, 1.05)),
            sdf_R_object=one.sdf_R_object,
            sdf_t_object=one.sdf_t_object,
            size_m=one.size_m,
        )
        low, high = vehicle_mesh(blended, decoder, resolution=MESH_RESOLUTION).bounds
        chosen.append(InsertableVehicle(blended, (low + high) / 2, high - low))
    return chosen


def with_inserted_vehicles(
    scene: TrainingScene,
    vehicles: Sequence[InsertableVehicle],
    decoder: ShapeDecoder,
    rng: np.random.Generator,
) -> TrainingScene:
    """The scene with two to four more vehicles, 8 to 60 m away, at any heading, clear of other things."""
    points, boxes = scene.points, scene.boxes
    origin = np.array((0.0, 0.0, scene.sensor_height_m))
    for _ in range(int(rng.integers(2, 5))):
        chosen = vehicles[int(rng.integers(len(vehicles)))]
        box = _free_place(points, boxes, chosen, rng)
        if box is None:
            continue
        # The box stands around the decoded surface, whose centre need not be the object's origin.
        cos, sin = np.cos(box[6]), np.sin(box[6])
        x, y, z = chosen.centre_m
        position = box[:3] - np.array((cos * x - sin * y, sin * x + cos * y, z))
        theta = torch.tensor((*position, box[6], 0.0, 0.0), dtype=torch.float64)
        field = decoder.field(torch.from_numpy(chosen.vehicle.latent_code))
        with torch.no_grad():
            rendering = render(Beams.from_arrays(points, origin), field, theta, chosen.vehicle, preset("draft"))
        points = rendering.points.numpy().astype(np.float32)
        boxes = np.concatenate((boxes, box[None].astype(np.float32)))
    return TrainingScene(points, boxes, scene.sensor_height_m)


def _free_place(
    points: Floats, boxes: Floats, chosen: InsertableVehicle, rng: np.random.Generator
) -> npt.NDArray[np.float64] | None:
    """A box on the ground that touches no other and holds no point above the ground, or None."""
    for _ in range(TRIES):
        distance, bearing, heading = (
            rng.uniform(8, 60),
            rng.uniform(-np.pi, np.pi),
            rng.uniform(-np.pi, np.pi),
        )
        x, y = distance * np.cos(bearing), distance * np.sin(bearing)
        reach = np.hypot(chosen.size_m[0], chosen.size_m[1]) / 2
        spread = np.hypot(boxes[:, 0] - x, boxes[:, 1] - y)
        if (spread < reach + np.hypot(boxes[:, 3], boxes[:, 4]) / 2).any():
            continue
        near = points[np.hypot(points[:, 0] - x, points[:, 1] - y) < reach + 1.0]
        if len(near) < GROUND_POINTS:
            continue  # out of sight
        ground = float(np.percentile(near[:, 2], 10))
        box = np.array((x, y, ground + chosen.size_m[2] / 2, *chosen.size_m, heading))
        space = box.copy()
        space[2] += CLEARANCE_M
        if not points_in_boxes(near, space[None], margin_m=0.1).any():
            return box
    return None
