"""Catalogue of the scenes, vehicles and detectors that settings refer to, with their content hashes."""
