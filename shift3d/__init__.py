"""Search for the blind spots of a LiDAR 3D detector (SHIFT3D)."""

__version__ = "0.1.0"
