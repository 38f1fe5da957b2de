"""Typed schema of a sweep's settings, with their valid values."""
