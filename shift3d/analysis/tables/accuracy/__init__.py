"""Accuracy against time: of a sweep, of the presets, and of every setting of the frontier."""
