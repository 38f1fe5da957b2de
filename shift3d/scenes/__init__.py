"""Scenes: one LiDAR sweep with its labels, read from KITTI or made by the procedural street."""
