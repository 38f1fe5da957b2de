"""Natural kin of a shape: labelled vehicles cropped from scenes, their shapes fitted to what was seen, the nearest."""
