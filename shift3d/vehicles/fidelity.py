"""Fidelity of the shipped decoder on the vehicle family: Chamfer distances for training vehicles and unseen ones.

`shift3d evaluate model=sdf` prints both medians; `shift3d.sdf.meshes` defines the distance.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from shift3d.sdf.autodecode import autodecode
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.meshes import extract_mesh, symmetric_chamfer
from shift3d.sdf.samples import sample_sdf
from shift3d.seeding import generator
from shift3d.vehicles.family import build_mesh, family
from shift3d.vehicles.vehicle import family_seed, family_vehicles

UNSEEN_SEED_OFFSET = 1_000_003
"""Offset from the training seed to the seed of vehicles of the same family that training never saw."""


def decoded_chamfer_m(decoder: Decoder, code: torch.Tensor, scale_m: float, mesh: trimesh.Trimesh, seed: int) -> float:
    """Compute the symmetric Chamfer distance in metres between a decoded code and a mesh in the object frame."""
    decoded = extract_mesh(decoder.field(code), 129)
    decoded.vertices = decoded.vertices * scale_m
    return symmetric_chamfer(decoded, mesh, generator("chamfer", seed))


def training_chamfer_m(decoder: Decoder, count: int) -> NDArray[np.float64]:
    """Compute Chamfer distances (count,) metres of training vehicles with their trained codes, body types in turn."""
    vehicles = family_vehicles()
    specs = family(len(vehicles), family_seed())
    results = []
    for index in range(count):
        code = torch.from_numpy(vehicles[index].latent_code)
        results.append(decoded_chamfer_m(decoder, code, vehicles[index].scale_m, build_mesh(specs[index]), index))
    return np.array(results)


def unseen_chamfer_m(decoder: Decoder, count: int) -> NDArray[np.float64]:
    """Compute Chamfer distances (count,) metres of unseen vehicles, each auto-decoded from samples of its mesh."""
    results = []
    seed = family_seed()
    for index, spec in enumerate(family(count, seed + UNSEEN_SEED_OFFSET)):
        mesh = build_mesh(spec)
        samples = sample_sdf(mesh, 50_000, generator("unseen", seed, index))
        code = autodecode(decoder, samples, seed=index)
        results.append(decoded_chamfer_m(decoder, code, samples.scale_m, mesh, index))
    return np.array(results)
