"""Accuracy against run time: errors of each renderer setting relative to the reference, and its milliseconds."""
