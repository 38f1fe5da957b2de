"""Placement of a vehicle in a scene: ground fit, constraints on a pose, and sampling of poses."""
