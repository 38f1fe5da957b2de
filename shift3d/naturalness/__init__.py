"""How near a shape is to vehicles: surface distances to the nearest member of a reference set, calibrated on the set.

`measure` says it of one shape, `sources` says where members come from, `reference` keeps them in one file.
"""
