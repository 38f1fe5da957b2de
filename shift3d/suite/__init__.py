"""Suites: hard objects of a sweep, frozen with their scenes, so that new weights can be scored on them."""
