"""Procedural vehicles: the embedded family, which the shipped decoder was trained on, and the wide one beside it.

The names here are those of the embedded family (`embedded`, `solid`); the wide one is in `wide`.
"""

from shift3d.vehicles.family.embedded import RANGES, family, sample_spec
from shift3d.vehicles.family.solid import build_mesh
from shift3d.vehicles.family.spec import BODY_TYPES, VehicleSpec

__all__ = ["BODY_TYPES", "RANGES", "VehicleSpec", "build_mesh", "family", "sample_spec"]
