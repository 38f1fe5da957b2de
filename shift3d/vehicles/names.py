"""Names of vehicle sets that ship with shift3d; anything else is a folder."""

from __future__ import annotations

WIDE = "wide"
"""The set of the parametric decoder, in `weights/wide`; a user's folder of that name is ./wide."""
