"""Incremental inference: each frame of a scene recomputes only cells that changed and that the output needs."""
