"""The measured setup: a held-out procedural street, a vehicle in it, the shipped decoder and detector."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.placement.sampling import Placement
from shift3d.render import SdfGrid
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.spec import AttackSpec, PlacementSpec, TaskSpec

__all__ = [
    "SHORT",
    "HeldScenes",
    "World",
    "densified",
    "make_spec",
    "open_assets",
    "open_world",
    "streets",
    "with_beams_elsewhere",
]

VEHICLE = "suv"
DETECTOR = "pointpillars"
_STREETS: dict[str, Any] = {"sensor": "mixed", "split": "test", "seed": 0, "count": 4}
# Not nearer: at a shorter range one rendering with the paper's renderer takes minutes on a slow core.
NEAREST_M, FARTHEST_M = 20.0, 25.0


@dataclass
class HeldScenes:
    """Scene set that also holds scenes made by the benchmarks, by their scene_id."""

    streets: StreetScenes
    made: dict[str, Scene] = field(default_factory=dict)

    @property
    def dataset(self) -> str:
        """See `SceneSet`."""
        return self.streets.dataset

    @property
    def placement_sector_rad(self) -> tuple[float, float]:
        """See `SceneSet`."""
        return self.streets.placement_sector_rad

    def names(self) -> list[str]:
        """See `SceneSet`."""
        return [*self.streets.names(), *self.made]

    def load(self, name: str) -> Scene:
        """See `SceneSet`."""
        return self.made[name] if name in self.made else self.streets.load(name)

    def hold(self, scene: Scene) -> str:
        """Keep a scene. Returns its name."""
        scene.validate()
        self.made[scene.scene_id] = scene
        return scene.scene_id


def streets() -> HeldScenes:
    """Return the measured streets, held out from every training."""
    return HeldScenes(StreetScenes(**_STREETS))


def open_assets(scenes: HeldScenes) -> Assets:
    """Return a worker's assets, with these scenes."""
    assets = load_assets(AssetsSpec(scenes={"kind": "street", **_STREETS}))
    return dataclasses.replace(assets, scenes=scenes, poses={})


def make_spec(scene: str, accuracy: str = "standard", **changes: object) -> TaskSpec:
    """Return a shape task of the vehicle in a scene, 20 to 25 m away unless `placement` says otherwise."""
    settings = accuracy_settings(AccuracyConfig(name=accuracy, render={}))  # type: ignore[arg-type]
    spec = TaskSpec(
        vehicle=VEHICLE,
        scene=scene,
        dataset="street-mixed",
        mode="shape",
        lambda_=1.0,
        alpha=0.01,
        detector=DETECTOR,
        accuracy=accuracy,
        accuracy_settings=settings,
        placement=PlacementSpec(min_range_m=NEAREST_M, max_range_m=FARTHEST_M),
    )
    return dataclasses.replace(spec, **changes)  # type: ignore[arg-type]


@dataclass
class World:
    """The vehicle at one place of one scene.

    theta: (6,) float64 pose. counterpart_scene: scene for the comparison with the paper's renderer: the same scene, or
    in a trial run one with fewer beams.
    """

    assets: Assets
    scenes: HeldScenes
    scene: str
    theta: Tensor
    counterpart_scene: str

    @property
    def range_m(self) -> float:
        """Horizontal distance of the vehicle from the sensor."""
        return math.hypot(float(self.theta[0]), float(self.theta[1]))

    def problem(
        self, scene: str | None = None, accuracy: str = "standard", theta: Tensor | None = None
    ) -> AttackProblem:
        """Return the attack as a task of this accuracy sets it up, with the detector at the search's precision."""
        spec = make_spec(scene or self.scene, accuracy)
        problem = build_problem(spec, self.assets, self.theta if theta is None else theta)
        precision = str(spec.accuracy_settings["detector"])
        return dataclasses.replace(problem, detector=self.assets.detector_of(spec.detector, precision))

    def sdf_grid(self, problem: AttackProblem) -> SdfGrid:
        """Return the vehicle's SDF grid, which a task makes once."""
        with torch.no_grad():
            return SdfGrid.of(problem.field_of(problem.code0), problem.vehicle, problem.settings)

    def place_at(self, range_m: float) -> tuple[str, Placement] | None:
        """Return a scene and a place for the vehicle at this range, within half a metre; None if no scene has one.

        Ten returns are enough, because far objects do not have 300.
        """
        where = PlacementSpec(min_range_m=range_m - 0.5, max_range_m=range_m + 0.5, min_object_points=10, attempts=100)
        for scene in self.scenes.streets.names():
            found = place_vehicle(make_spec(scene, placement=where), self.assets)
            if isinstance(found, Placement):
                return scene, found
        return None


def open_world(thin: int = 1) -> World:
    """Return the first street that has room for the vehicle at 20 to 25 m.

    thin: the counterpart scene keeps every thin-th beam.
    """
    scenes = streets()
    assets = open_assets(scenes)
    for name in scenes.streets.names():
        placement = place_vehicle(make_spec(name), assets)
        if isinstance(placement, Placement):
            counterpart = name if thin == 1 else scenes.hold(_thinned(scenes.load(name), thin))
            return World(assets, scenes, name, placement.theta, counterpart)
    raise RuntimeError("none of the streets has room for the vehicle: choose others")


def _with_points(scene: Scene, points: np.ndarray, suffix: str) -> Scene:
    """Return the same street with other points (N, 3), without any other data per point."""
    return Scene(
        scene_id=f"{scene.scene_id}-{suffix}",
        dataset=scene.dataset,
        points=points.astype(np.float32),
        origins=np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape),
        ground_z_m=scene.ground_z_m,
        labels=scene.labels,
    )


def _thinned(scene: Scene, every: int) -> Scene:
    return _with_points(scene, scene.points[::every], f"every{every}")


def with_beams_elsewhere(scene: Scene, theta: Tensor, factor: int, clear_m: float = 12.0) -> Scene:
    """Return the scene with `factor` times its beams, none of the new ones near the object.

    New beams are copies of the scene's beams, turned about the sensor by a random angle, each off by about a twentieth
    of a degree. Beams that pass within clear_m of the object's centre are left out: 7 m for the sphere outside which
    the renderer ignores beams, 4 m that a pose attack may move the object, and 1 m to spare.
    """
    rng = np.random.default_rng(factor)
    centre = theta[:3].double().numpy()
    original = scene.points.astype(np.float64)
    parts, wanted = [original], (factor - 1) * len(original)
    while wanted > 0:
        turned = _turned(original, rng.uniform(0.0, 2.0 * math.pi), rng)
        along = np.clip(turned @ centre / np.square(turned).sum(1), 0.0, 1.0)
        apart = np.linalg.norm(centre - along[:, None] * turned, axis=1) > clear_m
        parts.append(turned[apart][:wanted])
        wanted -= len(parts[-1])
    return _with_points(scene, np.concatenate(parts), f"{factor}x")


def densified(scene: Scene, count: int) -> Scene:
    """Return the scene with its own beams repeated, each slightly turned, until there are `count`."""
    rng = np.random.default_rng(count)
    original = scene.points.astype(np.float64)
    rows = rng.integers(0, len(original), max(0, count - len(original)))
    points = np.concatenate((original, _turned(original[rows], 0.0, rng)))[:count]
    return _with_points(scene, points, f"{count}points")


def _turned(points: np.ndarray, angle_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Turn points (N, 3) about the sensor's vertical axis, each by its own small extra angle."""
    angle = angle_rad + rng.normal(0.0, math.radians(0.05), len(points))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack((cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1], points[:, 2]), 1)


# A spec for a short task: all kinds of candidates of a task, few of each.
SHORT = AttackSpec(steps=3, random_replicates=1, noise_replicates=1)
