"""Training of the DeepSDF auto-decoder, on the family of vehicles or on the samples of any meshes.

Source: Park et al. 2019, section 4 and supplement (SHIFT3D trains "as the original DeepSDF paper"): clamped L1 with
delta 0.1, 1e-4 times the squared norm of the codes, ramped in, codes drawn from N(0, 0.01^2), Adam with 5e-4 for the
network and 1e-3 for the codes, weight norm. Our choice, for an hour of training on two cores: every step uses every
shape, the learning rate falls as a cosine, no dropout, bfloat16 in the wide layers over float32 weights, and vehicles
of the family, which are symmetric, are mirrored at random.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder
from shift3d.seeding import derive_seed
from shift3d.training.compute import ONE_THREAD, Compute
from shift3d.training.progress import Report
from shift3d.training.sdf.loop import DecoderRun, run_to_end
from shift3d.training.sdf_shapes import ShapeSamples, shape_samples


@dataclass(frozen=True)
class SdfRecipe:
    """Everything that decides the weights. Two trainings of one recipe with equal numbers of threads agree.

    source: "family", or an identifier of the meshes that the shapes come from (`ShapeSamples.source`). mirror: swap
    left and right at random; only for symmetric shapes.
    """

    shapes: int = 270
    samples_a_shape: int = 100_000
    batch_a_shape: int = 32
    steps: int = 9_000
    seed: int = 7
    network_rate: float = 5e-4
    code_rate: float = 1e-3
    clamp: float = 0.1
    code_penalty: float = 1e-4
    penalty_ramp: float = 0.05
    code_init_std: float = 0.01
    compute: str = "bfloat16"
    source: str = "family"
    mirror: bool = True


class SdfRun(DecoderRun):
    """One training of a decoder and of a code for every shape. Every step uses every shape."""

    table_name = "codes"

    def __init__(self, recipe: SdfRecipe, samples: ShapeSamples, compute: Compute) -> None:
        torch.manual_seed(derive_seed("sdf training", recipe.seed) % 2**63)
        decoder = Decoder(Architecture())
        codes = torch.randn(recipe.shapes, decoder.architecture.code_length) * recipe.code_init_std
        self.samples, self.rates = samples, (recipe.network_rate, recipe.code_rate)
        super().__init__(recipe, decoder, codes, compute, recipe.compute == "bfloat16")

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        recipe, samples, device = self.recipe, self.samples, self.compute.device
        rng = np.random.default_rng([recipe.seed, self.step])
        start = int(rng.integers(samples.points.shape[1] - recipe.batch_a_shape))
        chosen = slice(start, start + recipe.batch_a_shape)
        points = torch.from_numpy(samples.points[:, chosen].copy())
        if recipe.mirror:
            points[..., 1] *= torch.from_numpy(rng.choice(np.array([-1.0, 1.0], np.float32), points.shape[:2]))
        return self.table, points.to(device), torch.from_numpy(samples.distances[:, chosen].copy()).to(device)

    def penalty(self) -> Tensor:
        """Return the penalty on the codes' squared norm, ramped in."""
        ramp = min(1.0, self.step / (self.recipe.penalty_ramp * self.recipe.steps))
        weighed: Tensor = self.recipe.code_penalty * ramp * self.table.square().sum(dim=1).mean()
        return weighed


def train_sdf(
    out: Path,
    recipe: SdfRecipe | None = None,
    checkpoint_every: int = 1000,
    samples: ShapeSamples | None = None,
    compute: Compute = ONE_THREAD,
    report: Report | None = None,
) -> Path:
    """Train, or resume, and write `sdf.pt` (decoder, codes, recipe) to `out`.

    Args:
        out: folder of the sampled shapes and the checkpoint; the same folder and recipe resume.
        recipe: default the shipped recipe.
        checkpoint_every: steps between checkpoints; no influence on the result. SIGINT and SIGTERM also write one.
        samples: of the shapes to train on, default the family's; their number and source are those of the recipe.
        compute: default the CPU, one thread; another number of threads only changes the rounding.
        report: called with the curve's points after every checkpoint.
    Returns: the finished checkpoint.
    Raises: InputError when `out` holds another recipe's training; KeyboardInterrupt on SIGINT or SIGTERM.
    Source: Park et al. 2019, section 4; see the module for our choices.
    """
    recipe = recipe or SdfRecipe()
    compute.prepare()
    if samples is None:
        samples = shape_samples(recipe.shapes, recipe.samples_a_shape, recipe.seed, out / "shapes", compute.threads)
    if (len(samples.points), samples.source) != (recipe.shapes, recipe.source):
        raise InputError("samples of other shapes than the recipe's", str(out), "Give samples of the recipe's source")
    file = out / "sdf.pt"
    run_to_end(SdfRun(recipe, samples, compute), file, checkpoint_every, report)
    return file
