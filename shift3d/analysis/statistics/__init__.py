"""Intervals, tests and bands: scenes are what is resampled."""
