"""Scenes: one LiDAR sweep with labels, read from a recording or generated as a procedural street."""
