"""Suites: hard objects of a sweep, frozen with their scenes, on which new weights are scored."""
