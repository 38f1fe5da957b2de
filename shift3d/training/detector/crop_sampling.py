"""Crops of a training step: drawn at random from scenes, or every scene with an object once an epoch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from math import ceil, floor
from pathlib import Path

import numpy as np

from shift3d.detectors.grid import Grid
from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.training.detector.crops import Crop, random_crop
from shift3d.training.detector.pasting import VehicleDatabase
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector_scenes import TrainingScene, load_cached

LEAST_POINTS = 10  # of a crop: a batch norm has no statistics of a single point
TRIES = 50


class RandomCrops:
    """Crops of each step and for the batch norm statistics; the seed and the step alone decide them.

    mesh, inserted: cached scenes without and with insertions. database: vehicles to paste; None: nothing is pasted.
    """

    def __init__(
        self,
        recipe: Recipe,
        grid: Grid,
        mesh: Sequence[Path],
        inserted: Sequence[Path],
        database: VehicleDatabase | None,
    ) -> None:
        self.recipe, self.grid = recipe, grid
        self.mesh, self.inserted, self.database = mesh, inserted, database

    def of(self, step: int, slot: int) -> Crop:
        """Return one crop. Raises: InputError if the scenes hold almost no points."""
        recipe, rng = self.recipe, self._generator(step, slot)
        use_inserted = step >= recipe.mesh_only_steps and rng.random() < recipe.inserted_share
        return self._any(self.inserted if use_inserted and len(self.inserted) else self.mesh, rng, step)

    def of_statistics(self) -> Iterator[Crop]:
        """Return an endless iterator of crops that belong to no step."""
        return (self.of(self.recipe.all_steps, slot) for slot in count(0))

    def _generator(self, step: int, slot: int) -> np.random.Generator:
        return generator(f"{self.recipe.detector} crop", self.recipe.seed, step, slot)

    def _any(self, files: Sequence[Path], rng: np.random.Generator, step: int) -> Crop:
        for _ in range(TRIES):
            crop = self._cut(load_cached(files[int(rng.integers(len(files)))]), rng)
            if len(crop.points_inside(self.grid)) >= LEAST_POINTS:
                return crop
        what = f"{TRIES} crops in a row hold fewer than {LEAST_POINTS} points"
        raise InputError(what, f"step {step}", "Give scenes with points")

    def _cut(self, scene: TrainingScene, rng: np.random.Generator, around_last: bool = False) -> Crop:
        around = np.asarray(scene.boxes[-1, :2], dtype=np.float64) if around_last else None
        return random_crop(scene, self.grid, self.recipe, rng, self.database, around)


class EpochCrops(RandomCrops):
    """Crops that show every inserted scene once an epoch, cut about its last box.

    A share of `recipe.inserted_share`; other crops are `RandomCrops` without insertion. The seed alone sets the order.
    """

    def of(self, step: int, slot: int) -> Crop:
        """Return one crop. Raises: InputError if the scenes hold almost no points."""
        share, number, rng = self.recipe.inserted_share, step * self.recipe.batch + slot, self._generator(step, slot)
        before = floor(number * share)
        if floor((number + 1) * share) == before:
            return self._any(self.mesh, rng, step)
        epoch, place = divmod(before, len(self.inserted))
        order = generator("fine-tuning epoch", self.recipe.seed, epoch).permutation(len(self.inserted))
        return self._cut(load_cached(self.inserted[int(order[place])]), rng, around_last=True)


def epoch_steps(objects: int, recipe: Recipe) -> int:
    """Compute the steps in which `EpochCrops` shows each object once; the last step may begin the next epoch."""
    crops = ceil(objects / recipe.inserted_share)
    while floor(crops * recipe.inserted_share) < objects:  # the product may round down
        crops += 1
    return ceil(crops / recipe.batch)
