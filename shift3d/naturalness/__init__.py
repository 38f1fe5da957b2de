"""Naturalness of a shape: surface distances to the nearest member of a reference set, calibrated on the set.

`measure` measures one shape, `sources` provides the members, `reference` stores them in one file.
"""
