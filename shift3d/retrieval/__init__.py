"""Nearest natural vehicles of a shape: labelled vehicles cropped from scenes, with shapes fitted to their points."""
