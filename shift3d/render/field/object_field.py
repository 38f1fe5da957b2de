"""Field of a vehicle in its object frame and in metres."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from shift3d.sdf.bfloat16 import Bfloat16Field
from shift3d.sdf.field import Field as DecoderField
from shift3d.sdf.linear_regions import LinearRegion

_LEAST_SAVED = 96
"""Below this number of points fetching the weights takes as long as evaluating: evaluate once, in float32."""


LiveUnits = tuple[Tensor, ...] | None
"""Hidden units that are on (positive) at some point: one bool mask per hidden layer. None: unknown, evaluate all units.
"""


def union_of_units(a: LiveUnits, b: LiveUnits) -> LiveUnits:
    """Unite two surveys: units that are on in one of them; None if one is unknown."""
    if a is None or b is None:
        return None
    return tuple(one | other for one, other in zip(a, b, strict=True))


class Field(Protocol):
    """Signed distance of one shape in the frame that the decoder was trained in (sdf frame), negative inside."""

    def __call__(self, x_sdf: Tensor, /) -> Tensor:
        """Map sdf-frame points (N, 3) to distances (N,) in sdf units, in the dtype of x_sdf."""
        ...


@runtime_checkable
class PiecewiseField(Protocol):
    """A field that is piecewise linear along lines, up to a final function that preserves sign and roots (tanh)."""

    def region(self, x_sdf: Tensor, direction: Tensor, /) -> LinearRegion:
        """Return the linear regions on which lines start; see `sdf.linear_regions.linear_region`."""
        ...


class VehicleFrame(Protocol):
    """Transform from the object frame to the sdf frame: x_sdf = sdf_R_object x_object / scale_m + sdf_t_object."""

    @property
    def scale_m(self) -> float: ...
    @property
    def sdf_R_object(self) -> np.ndarray: ...
    @property
    def sdf_t_object(self) -> np.ndarray: ...
    @property
    def size_m(self) -> tuple[float, float, float] | np.ndarray: ...


@dataclass
class EvaluationCount:
    """Numbers of points at which a field was evaluated: all, and those in bfloat16 alone (`coarse`)."""

    evaluations: int = 0
    coarse: int = 0


@dataclass(frozen=True)
class ObjectField:
    """Metric signed distance in the object frame: scale_m * g(x_sdf).

    Takes (N, 3) float64 object-frame points, evaluates the field in `dtype`, returns (N,) in `dtype`. Differentiable
    with respect to the points and whatever the field depends on. Source: SHIFT3D, Pose Transformation; the scale ("we
    manually scaled each baseline object") is a property of the vehicle.
    """

    sdf: Field
    scale_m: float
    sdf_R_object: Tensor  # noqa: N815
    sdf_t_object: Tensor
    dtype: torch.dtype
    batch: int
    bfloat16_band_m: float = 0.0
    count: EvaluationCount = dataclasses.field(default_factory=EvaluationCount)

    @staticmethod
    def of(
        sdf: Field, vehicle: VehicleFrame, dtype: torch.dtype, batch: int, bfloat16_band_m: float = 0.0
    ) -> ObjectField:
        """Build the field of a vehicle, evaluated in `dtype`, `batch` points at a time.

        bfloat16_band_m: `estimate` uses bfloat16 farther than this from the surface; 0: never.
        """
        return ObjectField(
            sdf,
            float(vehicle.scale_m),
            torch.as_tensor(np.asarray(vehicle.sdf_R_object, dtype=np.float64)),
            torch.as_tensor(np.asarray(vehicle.sdf_t_object, dtype=np.float64)),
            dtype,
            batch,
            bfloat16_band_m,
        )

    @property
    def rough(self) -> Bfloat16Field | None:
        """The field in bfloat16; None if bfloat16 is not allowed or not fast."""
        if not isinstance(self.sdf, DecoderField) or self.dtype != torch.float32 or self.bfloat16_band_m <= 0:
            return None
        return self.sdf.rough

    def __call__(self, x_object: Tensor) -> Tensor:
        x_sdf = self.to_sdf(x_object)
        self.count.evaluations += len(x_sdf)
        if len(x_sdf) <= self.batch:
            return self.sdf(x_sdf) * self.scale_m if len(x_sdf) else x_sdf[:, 0]
        return torch.cat([self.sdf(part) for part in x_sdf.split(self.batch)]) * self.scale_m

    def estimate(self, x_object: Tensor, expected_m: Tensor | None = None) -> Tensor:
        """Estimate distances for choosing samples: exact inside and within bfloat16_band_m of the surface.

        expected_m: (N,) expected distances, NaN where unknown. A point that is expected to be near is evaluated exactly
        at once; an estimate first would cost a second evaluation. Not differentiable.
        """
        far = torch.arange(len(x_object))
        if expected_m is not None:  # NaN compares false
            far = torch.nonzero(~(expected_m < self.bfloat16_band_m)).squeeze(1)
        if self.rough is None or len(far) < _LEAST_SAVED:
            return self(x_object)
        parts = self.to_sdf(x_object[far]).split(self.batch)
        rough = torch.cat([self.rough(part) for part in parts]) * self.scale_m
        g = torch.zeros(len(x_object), dtype=rough.dtype).index_copy(0, far, rough)
        # A NaN is evaluated again, too.
        near = torch.nonzero(~(g >= self.bfloat16_band_m)).squeeze(1)
        self.count.evaluations += len(x_object) - len(near)
        self.count.coarse += len(x_object) - len(near)
        if len(near):
            g[near] = self(x_object[near])
        return g

    def survey(self, x_object: Tensor) -> tuple[Tensor, LiveUnits]:
        """Estimate the distances at points (N, 3), and find the hidden units that are on at any of these points.

        The distances are for choosing samples, in bfloat16 if `estimate` uses it. The units are None for a field that
        is no decoder's. Not differentiable.
        """
        if not isinstance(self.sdf, DecoderField):
            return self(x_object), None
        self.count.evaluations += len(x_object)
        self.count.coarse += len(x_object) if self.rough is not None else 0
        parts = [(self.rough or self.sdf).survey(part) for part in self.to_sdf(x_object).split(self.batch)]
        live = tuple(torch.stack(masks).any(0) for masks in zip(*(on for _, on in parts), strict=True))
        return torch.cat([g for g, _ in parts]) * self.scale_m, live

    def sliced(self, live: LiveUnits) -> ObjectField:
        """Return the field without the hidden units that are off, with the same counter; itself if `live` is None."""
        if live is None or not isinstance(self.sdf, DecoderField):
            return self
        return dataclasses.replace(self, sdf=self.sdf.sliced(live))

    def float32_copy(self) -> ObjectField | None:
        """Return the field in float32, with the same counter; None if it is float32 already or is not a decoder's.

        Differs by the rounding of weights and arithmetic, see `settings.reachable_residual_m`.
        """
        if not isinstance(self.sdf, DecoderField) or self.dtype == torch.float32:
            return None
        weights, biases = ([part.float() for part in parts] for parts in (self.sdf.weights, self.sdf.biases))
        copy = DecoderField(weights, biases, self.sdf.skip_layer)
        return dataclasses.replace(self, sdf=copy, dtype=torch.float32)

    def piecewise_linear(self) -> bool:
        """True if the field can return its linear regions along a beam."""
        return isinstance(self.sdf, PiecewiseField)

    def region(self, x_object: Tensor, direction: Tensor) -> LinearRegion:
        """Compute the linear regions on which beams start; counts as two evaluations each.

        Args: x_object: (N, 3) starts. direction: (N, 3) unit vectors; both object frame, float64.
        Returns: values in metres, slopes in metres per metre, lengths in metres; float64.
        """
        assert isinstance(self.sdf, PiecewiseField)
        self.count.evaluations += 2 * len(x_object)
        along = direction @ (self.sdf_R_object.T / self.scale_m)
        parts = [
            self.sdf.region(x, d)
            for x, d in zip(self.to_sdf(x_object).split(self.batch), along.split(self.batch), strict=True)
        ]
        value, slope, length = (
            torch.cat([getattr(part, name) for part in parts]).double() for name in ("value", "slope", "length")
        )
        return LinearRegion(value * self.scale_m, slope * self.scale_m, length)

    def to_sdf(self, x_object: Tensor) -> Tensor:
        """Transform points (N, 3) from the object frame to the sdf frame, in the field's dtype."""
        x_sdf = x_object @ (self.sdf_R_object.T / self.scale_m) + self.sdf_t_object
        return x_sdf.to(self.dtype)

    def depends_on_code(self) -> bool:
        """True if the field carries gradients to a latent code that requires them."""
        if not torch.is_grad_enabled():
            return False
        if isinstance(self.sdf, DecoderField):
            return bool(self.sdf.code_layers)
        return bool(self.sdf(torch.zeros(1, 3, dtype=self.dtype)).requires_grad)
