"""Statistics of sweeps: intervals, tests and bands that resample whole scenes."""
