"""Renderer: inserts a vehicle into a LiDAR scene (beams, first hits, implicit gradients)."""

from shift3d.render.beams import Beams
from shift3d.render.field.object_field import Field, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import PRESETS, RenderSettings, preset

__all__ = ["PRESETS", "Beams", "Field", "RenderSettings", "Rendering", "SdfGrid", "VehicleFrame", "preset", "render"]
