"""Scenes: one LiDAR sweep with its labels, read from a recording or made by the procedural street."""
