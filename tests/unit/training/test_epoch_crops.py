"""An epoch takes every object once, in a crop about it, between crops of scenes without objects."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shift3d.detectors.grid import WAYMO_GRID
from shift3d.training.detector.crop_sampling import EpochCrops, epoch_steps
from shift3d.training.detector.recipe import Augmentation, Recipe
from shift3d.training.detector_scenes import TrainingScene, cache_scenes

STILL = Augmentation(
    turn_rad=(0.0, 0.0), flip=0.0, scale=(1.0, 1.0), object_scale=(1.0, 1.0), shift_m=0.0, ground_shift_m=(0.0, 0.0),
    ground_slope=0.0, kept_points=(1.0, 1.0), dropped_lines=0.0, range_noise_m=(0.0, 0.0), swallowed=0.0, pasted=0,
)  # fmt: skip
RECIPE = Recipe(augmentation=STILL, crop_cells=96, jitter_m=8.0, mesh_only_steps=0)
NATURAL_M, OBJECTS = 4.0, 7


def scene(name: str) -> TrainingScene:
    """Return two vehicles far apart; the last one's length identifies it: 5 m plus its number in centimetres."""
    kind, number = name.split("-")
    rng = np.random.default_rng(int(number))
    length = NATURAL_M if kind == "natural" else 5.0 + 0.01 * int(number)
    boxes = np.array([[-30.0, 5.0, 0.8, NATURAL_M, 1.8, 1.6, 0.0], [25.0, -10.0, 0.8, length, 1.8, 1.6, 0.0]])
    points = [rng.uniform((-45, -45, 0), (45, 45, 0.02), (3000, 3))]
    points += [box[:3] + rng.uniform(-0.45, 0.45, (60, 3)) * box[3:6] for box in boxes]
    return TrainingScene(np.concatenate(points).astype(np.float32), boxes.astype(np.float32), 1.73)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], list[Path]]:
    folder = tmp_path_factory.mktemp("scenes")
    natural = cache_scenes(folder, [f"natural-{number}" for number in range(2)], scene)
    return natural, cache_scenes(folder, [f"object-{number}" for number in range(OBJECTS)], scene)


def taken(recipe: Recipe, files: tuple[list[Path], list[Path]], steps: int) -> list[float]:
    """Return the length of the last box of every crop; that of a natural vehicle for a crop without a box."""
    crops = EpochCrops(recipe, WAYMO_GRID, *files, None)
    found = []
    for step in range(steps):
        for slot in range(recipe.batch):
            crop = crops.of(step, slot)
            if not len(crop.boxes):
                found.append(NATURAL_M)
                continue
            (x, y), window = crop.boxes[-1, :2], crop.window
            if crop.boxes[-1, 3] > NATURAL_M:
                side = WAYMO_GRID.cell_m
                west, south = WAYMO_GRID.x_min_m + side * window.x0, WAYMO_GRID.y_min_m + side * window.y0
                assert west < x < west + 96 * side and south < y < south + 96 * side
                assert crop.usable[-1]
            found.append(round(float(crop.boxes[-1, 3]), 2))
    return found


@pytest.mark.parametrize(("share", "batch"), [(0.5, 2), (1.0, 2), (1.0, 1), (0.3, 2), (0.25, 3)])
def test_an_epoch_takes_every_object_once(share: float, batch: int, files: tuple[list[Path], list[Path]]) -> None:
    recipe = replace(RECIPE, inserted_share=share, batch=batch)
    steps = epoch_steps(OBJECTS, recipe)
    found = taken(recipe, files, steps)
    objects = [length for length in found if length > NATURAL_M]
    first = Counter(objects[:OBJECTS])
    assert first == Counter(round(5.0 + 0.01 * number, 2) for number in range(OBJECTS))
    assert len(objects) - OBJECTS < batch, "the last step alone may begin another epoch"
    assert len(objects) == pytest.approx(share * len(found), abs=1)
    assert steps == -(-len(found) // batch)


def test_another_seed_takes_them_in_another_order_and_the_same_seed_in_the_same(
    files: tuple[list[Path], list[Path]],
) -> None:
    whole = replace(RECIPE, inserted_share=1.0, batch=1)
    orders = [taken(replace(whole, seed=seed), files, OBJECTS) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]
    assert sorted(orders[0]) == sorted(orders[2])
