"""A code for a mesh that the decoder was not trained on."""

from __future__ import annotations

import numpy as np
import torch

from shift3d.sdf.autodecode import autodecode
from shift3d.sdf.decoder import load_decoder
from shift3d.sdf.samples import sample_sdf
from shift3d.seeding import generator
from shift3d.vehicles.family import build_mesh, sample_spec


def test_code_explains_an_unseen_vehicle_and_is_reproducible() -> None:
    decoder = load_decoder()
    mesh = build_mesh(sample_spec("hatchback", generator("autodecode test")), resolution_m=0.05)
    samples = sample_sdf(mesh, 8000, generator("autodecode samples"))
    code = autodecode(decoder, samples, steps=80, batch=512)
    assert code.shape == (256,)
    short = [autodecode(decoder, samples, steps=4, batch=256, seed=5) for _ in range(2)]
    assert torch.equal(short[0], short[1])

    def error(z: torch.Tensor) -> float:
        with torch.no_grad():
            found = decoder.field(z)(torch.from_numpy(samples.points[::8])).clamp(-0.1, 0.1).numpy()
        return float(np.abs(found - samples.distances[::8].clip(-0.1, 0.1)).mean())

    assert error(code) < 0.008
    assert error(code) < 0.4 * error(torch.zeros(256))
