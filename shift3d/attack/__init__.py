"""Attacks: follow a detector's gradient to a shape or a pose that the detector misses."""
