"""Recipe of detector training: everything that decides the weights, beside the scenes."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite, pi

from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.models.anchor_heads import AnchorSpec
from shift3d.detectors.models.backbone import WAYMO_BACKBONE, BackboneSpec
from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import PILLAR_NETWORKS, PointPillarsNet
from shift3d.detectors.models.sst import SstNet, SstSpec
from shift3d.errors import InputError

Range = tuple[float, float]
"""Bounds (low, high) of a uniform draw; equal bounds are a constant."""


@dataclass(frozen=True)
class Augmentation:
    """Random differences between a crop and its scene. Metres, radians, shares in [0, 1].

    turn_rad, scale, flip: rotation about the sensor, global scaling, and the share of mirrored crops. object_scale:
    scaling of each vehicle about the middle of its bottom face; Source: random object scaling of ST3D (Yang et al.
    2021), against a size prior. object_stretch: a range of further factors for length, width and height, or three
    ranges in that order, so that no proportion is that of one family (our choice). shift_m: largest shift in x and y.
    ground_shift_m, ground_slope: height of the nominal ground, and the largest slope of half of the crops; boxes stay
    on the visible ground.

    kept_points: share of points kept, in half of the crops. dropped_lines: share of crops that lose whole scan lines.
    kept_line_in: range of n, where one line in n stays (or is dropped). range_noise_m: standard deviation along the
    beam. swallowed: share of vehicles that lose part of their returns, as to glass or dark paint.

    pasted: largest number of vehicles of other scenes pasted into a crop's scene; Source: ground-truth sampling of
    SECOND (Yan et al. 2018), section 3.4. pasted_range: factors from the measured to the new range; points are thinned
    by the square. range_bins_m: edges of range bins; every non-empty bin gives a crop's vehicle with equal probability.
    """

    turn_rad: Range = (-pi, pi)
    flip: float = 0.5
    scale: Range = (0.95, 1.05)
    object_scale: Range = (0.92, 1.08)
    object_stretch: tuple[float, ...] = (1.0, 1.0)
    shift_m: float = 0.3
    ground_shift_m: Range = (-0.2, 0.4)
    ground_slope: float = 0.015
    kept_points: Range = (0.6, 1.0)
    dropped_lines: float = 0.25
    kept_line_in: tuple[int, int] = (2, 3)
    range_noise_m: Range = (0.0, 0.03)
    swallowed: float = 0.3
    pasted: int = 4
    pasted_range: Range = (1.0, 1.6)
    range_bins_m: tuple[float, ...] = (0.0, 30.0, 50.0, 75.0)

    def validate(self, where: str) -> None:
        """Refuse empty ranges and shares outside [0, 1]. Raises: InputError naming the field."""
        sizes = ("scale", "object_scale")
        for name in ("turn_rad", *sizes, "ground_shift_m", "kept_points", "range_noise_m"):
            _check_range(name, getattr(self, name), where)
        for name in (*sizes, "kept_points"):
            _check(getattr(self, name)[0] > 0.0, name, getattr(self, name), where, "Give a range above 0")
        stretch = self.object_stretch
        _check(len(stretch) in (2, 6), "object_stretch", stretch, where, "Give one range, or one for each axis")
        for row in range(0, len(stretch), 2):
            _check_range("object_stretch", stretch[row : row + 2], where)
        _check(min(stretch) > 0.0, "object_stretch", stretch, where, "Give ranges above 0")
        _check_range("kept_line_in", self.kept_line_in, where)
        _check(self.kept_line_in[0] >= 2, "kept_line_in", self.kept_line_in, where, "Give whole numbers from 2")
        _check_range("pasted_range", self.pasted_range, where)
        _check(self.pasted_range[0] >= 1.0, "pasted_range", self.pasted_range, where, "Points can only be thinned")
        for name in ("flip", "dropped_lines", "swallowed"):
            value = getattr(self, name)
            _check(0.0 <= value <= 1.0, name, value, where, "Give a share from 0 to 1")
        for name in ("shift_m", "ground_slope", "pasted"):
            _check(0.0 <= getattr(self, name) < float("inf"), name, getattr(self, name), where, "Give 0 or more")
        bins = self.range_bins_m
        rising = len(bins) >= 2 and bins[0] >= 0.0 and all(low < high for low, high in pairwise(bins))
        _check(rising, "range_bins_m", bins, where, "Give at least two rising edges, such as 0,30,75")


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the trained weights, beside the scenes. Threads are not part of it.

    network, heads: sizes of the network, and kind of its heads (`PILLAR_NETWORKS`): the detector. anchor_size_m:
    length, width, height of the anchors: the means of published cars. grown_from: name of a detector whose shipped
    weights, doubled in width and depth, are the start; see `warm_start.grown`. backbone_from: name of a detector whose
    shipped encoder and backbone are the start, under heads of random weights.

    steps: optimiser steps. The first `mesh_only_steps` use scenes without inserted vehicles; later each crop comes from
    a scene with inserted vehicles with probability `inserted_share`. crop_cells: side of the square crops, trained to
    their edges, which look like the grid's edges. batch: crops per step. jitter_m: largest offset in x and y of a
    crop's centre from its vehicle. empty_share: share of crops cut anywhere. min_points: a vehicle with fewer points is
    neither a target nor background. bfloat16: compute large products in half the bytes where the processor can.

    box_weight, direction_weight: loss weights relative to the class loss; directions and anchor_size_m apply to anchors
    alone. code_weights: weights of the seven values of a box (x, y, z, length, width, height, heading). box_beta: error
    at which the box loss of anchors turns from quadratic to linear. centre_radius: cells around a vehicle's centre that
    regress its box, centres only.

    statistics_crops: crops whose single batch gives the batch norms' statistics after `steps`, so that every layer has
    exactly the statistics of inference; 0: the running means of training. settle_steps: steps after that, which train
    the heads alone, from `settle_rate` down, on features as at inference. During `steps` a batch norm uses the
    statistics of one small batch, and the heads learn with the difference (our choice).
    """

    network: BackboneSpec | SstSpec = WAYMO_BACKBONE
    heads: str = "anchors"
    anchor_size_m: tuple[float, float, float] = (4.4, 1.8, 1.55)
    grown_from: str = ""
    backbone_from: str = ""
    steps: int = 20_000
    mesh_only_steps: int = 2700
    inserted_share: float = 0.5
    mesh_scenes: int = 400
    inserted_scenes: int = 240
    crop_cells: int = 112
    batch: int = 2
    jitter_m: float = 11.0
    empty_share: float = 0.15
    min_points: int = 5
    augmentation: Augmentation = field(default_factory=Augmentation)
    peak_rate: float = 1.5e-3
    weight_decay: float = 0.01
    warm_up_share: float = 0.3
    clip_norm: float = 10.0
    box_weight: float = 2.0
    direction_weight: float = 1.0
    code_weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    box_beta: float = 1.0 / 27.0
    centre_radius: int = 1
    statistics_crops: int = 64
    settle_steps: int = 600
    settle_rate: float = 5e-4
    bfloat16: bool = True
    seed: int = 0

    @property
    def all_steps(self) -> int:
        """Number of steps, including the settle steps of the heads."""
        return self.steps + self.settle_steps

    @property
    def detector(self) -> str:
        """Name of the detector with these sizes and heads."""
        if isinstance(self.network, SstSpec):
            return self.network.name
        return PILLAR_NETWORKS[self.heads].name

    def new_network(self) -> DetectorNet:
        """Make an untrained network from torch's global random state."""
        anchors = AnchorSpec(self.anchor_size_m)
        if isinstance(self.network, SstSpec):
            return SstNet(self.network, anchors=anchors)
        if self.heads == "anchors":
            return PointPillarsNet(self.network, anchors=anchors)
        return PILLAR_NETWORKS[self.heads](self.network)

    def validate(self, where: str = "recipe") -> Recipe:
        """Check the recipe and return it. Raises: InputError naming the first invalid field."""
        possible = tuple(PILLAR_NETWORKS) if isinstance(self.network, BackboneSpec) else ("anchors",)
        _check(self.heads in possible, "heads", self.heads, where, f"Give {' or '.join(possible)}")
        weights = self.code_weights
        possible_weights = len(weights) == 7 and all(0.0 <= weight < float("inf") for weight in weights)
        _check(possible_weights, "code_weights", weights, where, "Give seven numbers, 0 or more")
        _check(len(self.anchor_size_m) == 3, "anchor_size_m", self.anchor_size_m, where, "Give length,width,height")
        for name in ("crop_cells", "batch", "mesh_scenes", "min_points"):
            _check(getattr(self, name) >= 1, name, getattr(self, name), where, "Give 1 or more")
        for name in ("anchor_size_m", "peak_rate", "settle_rate", "clip_norm", "box_beta"):
            value = getattr(self, name)
            values = value if isinstance(value, tuple) else (value,)
            _check(all(0.0 < v < float("inf") for v in values), name, value, where, "Give numbers above 0")
        for name in ("steps", "settle_steps", "mesh_only_steps", "inserted_scenes", "statistics_crops", "centre_radius",
                     "jitter_m", "weight_decay", "box_weight", "direction_weight"):  # fmt: skip
            _check(0.0 <= getattr(self, name) < float("inf"), name, getattr(self, name), where, "Give 0 or more")
        unused = self.inserted_scenes > 0 and self.inserted_share > 0.0 and self.mesh_only_steps > self.steps
        remedy = "Give fewer mesh_only_steps, or steps=N beside the recipe: no step draws an inserted scene"
        _check(not unused, "mesh_only_steps", self.mesh_only_steps, where, remedy)
        for name in ("inserted_share", "empty_share", "warm_up_share"):
            _check(0.0 <= getattr(self, name) <= 1.0, name, getattr(self, name), where, "Give a share from 0 to 1")
        _check(self.crop_cells % 4 == 0, "crop_cells", self.crop_cells, where, "Give a multiple of 4")
        cells = min(WAYMO_GRID.num_x, WAYMO_GRID.num_y)
        _check(self.crop_cells <= cells, "crop_cells", self.crop_cells, where, f"Give {cells}, the grid's, or fewer")
        self.augmentation.validate(where)
        return self


def _check(holds: bool, name: str, value: object, where: str, remedy: str) -> None:
    if not holds:  # a NaN fails every comparison
        raise InputError(f"{name}={value}", where=where, remedy=remedy)


def _check_range(name: str, value: tuple[float, ...], where: str) -> None:
    holds = len(value) == 2 and all(isfinite(end) for end in value) and value[0] <= value[1]
    _check(holds, name, value, where, "The range is empty: give LOW,HIGH with LOW <= HIGH")
