"""Procedural vehicles: the embedded family, on which the shipped decoder was trained, and the wide family.

This package exports the names of the embedded family (`embedded`, `solid`); module `wide` has the wide family.
"""

from shift3d.vehicles.family.embedded import RANGES, family, sample_spec
from shift3d.vehicles.family.solid import build_mesh
from shift3d.vehicles.family.spec import BODY_TYPES, VehicleSpec

__all__ = ["BODY_TYPES", "RANGES", "VehicleSpec", "build_mesh", "family", "sample_spec"]
